"""The words of `train infrared` and `clouds infrared`, and what they leave behind."""

WEIGHTS = ("net0.safetensors", "net1.safetensors")
TRAINING = ["--split", "test", "--scale", "tiny", "--steps", "4", "--batch", "2", "--folds", "2"]


def train_words(out, *more, data="headset"):
    return ["train", "infrared", "--data", data, "--out", str(out), *TRAINING, *more]


def clouds_words(run, output, *more, data="headset"):
    words = ["--data", data, "--split", "test", "--output", str(output), *more]
    return ["clouds", "infrared", "--run", str(run), *words]


def contents(run, names=("run.json", *WEIGHTS)):
    return {name: (run / name).read_bytes() for name in names}
