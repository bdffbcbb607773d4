"""The words of `train vector_field` and `estimate vector_field`, and what they leave behind."""

WEIGHTS = ("net.safetensors", "refiner.safetensors")
TRAINING = ["--objects", "1", "3", "--steps", "12", "--refiner-steps", "6"]


def train_words(source, out, *more):
    return ["train", "vector_field", "--data", source, "--out", str(out), *TRAINING, *more]


def estimate_words(run, source, output, *more):
    words = ["--run", str(run), "--data", source, "--output", str(output), *more]
    return ["estimate", "vector_field", *words]


def contents(run, names=("run.json", *WEIGHTS)):
    return {name: (run / name).read_bytes() for name in names}
