"""What `train` is for every method, with a method made up."""

import argparse
from types import SimpleNamespace

import pytest
import torch
from torch import nn

from posecore.methods import training
from posecore.methods.runs import Run
from posecore.methods.training import Job, add_parser, integer_option, open_data


def parsed(*words, command=print):
    parser = argparse.ArgumentParser()
    add_parser(parser.add_subparsers(), "made_up", command, summary="one", description="Some.")
    return parser.parse_args(["made_up", "--data", "bop:three", "--out", "RUN", *words])


def test_an_interrupted_training_says_how_to_go_on(capsys):
    def interrupted(options):
        assert options.data == "bop:three"
        raise KeyboardInterrupt

    options = parsed(command=interrupted)
    with pytest.raises(SystemExit, match="130"):
        options.command(options)
    assert capsys.readouterr().err == "\nstopped; the same command goes on from here\n"


def test_integers():
    assert integer_option("--steps", None, 7, 1) == 7
    assert integer_option("--steps", None, None, 1) is None
    assert integer_option("--steps", 3, 7, 1) == 3
    with pytest.raises(ValueError, match="^--steps: "):
        integer_option("--steps", 0, 7, 1)


def test_the_job_that_is_asked_for(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("WORLD_SIZE", raising=False)
    monkeypatch.delenv("RANK", raising=False)
    job = Job.asked(parsed("--device", "cpu"))
    assert (str(job.path), job.scale, job.device) == ("RUN", "tiny", torch.device("cpu"))
    assert (job.processes, job.first) == (1, True)
    monkeypatch.setenv("WORLD_SIZE", "4")
    monkeypatch.setenv("RANK", "3")
    job = Job.asked(parsed("--scale", "book", "--device", "cpu"))
    assert (job.scale, job.processes, job.first) == ("book", 4, False)
    monkeypatch.delenv("WORLD_SIZE")  # alone a place trained, and wrote nothing
    with pytest.raises(ValueError, match="^RANK: .* got '3'"):
        Job.asked(parsed("--device", "cpu"))
    monkeypatch.delenv("RANK")
    with pytest.raises(ValueError, match="^device: .* got 'meta'"):
        Job.asked(parsed("--device", "meta"))
    with pytest.raises(ValueError, match="^--seed: "):
        Job.asked(parsed("--seed", "-1"))
    with pytest.raises(ValueError, match="^device: "):
        Job.asked(parsed("--device", "moon"))
    (tmp_path / "RUN").write_text("")
    with pytest.raises(ValueError, match="^--out: expected a folder, got the file 'RUN'"):
        Job.asked(parsed())


@pytest.mark.slow
@pytest.mark.parametrize("first", [True, False])
def test_a_network_is_trained_and_kept_by_the_first_process(tmp_path, capsys, first):
    run, job = Run(tmp_path, {"seed": 5}), Job(tmp_path, "tiny", torch.device("cpu"), 2, first)
    model = nn.Linear(1, 1)
    before = model.weight.clone()

    def loss(net, batch):
        return (net(batch) - 1).square().mean()

    job.fit(run, "line", model, [torch.ones(4, 1)] * 3, loss, steps=3, lr=0.1)
    assert not torch.equal(before, model.weight)
    assert (tmp_path / "line.safetensors").exists() == first
    assert capsys.readouterr().out.startswith("line: ") == first
    assert list((tmp_path / "checkpoints" / "line").glob("weights-*3.safetensors"))


@pytest.fixture
def opened(three, monkeypatch):
    """`three` with models, and how it is opened."""
    calls = []

    def open_three(*arguments, **options):
        calls.append((*arguments, options))
        return three

    monkeypatch.setattr(training, "open_source", open_three)
    monkeypatch.setattr(training, "load", lambda dataset, progress: SimpleNamespace(kinds=("rgb",)))
    monkeypatch.setattr(type(three), "models", lambda self: "models")
    return calls


JOB = Job(None, "tiny", torch.device("cpu"), 1, True)


def test_data_and_objects(opened):
    data = open_data(parsed(), JOB, {"rgb": "colour images"})
    assert (data.models, data.objects, data.stack.kinds) == ("models", [4, 7], ("rgb",))
    assert opened == [("bop:three", "train", "tiny", {"show": True})]
    assert open_data(parsed("--objects", "7", "7"), JOB, {}).objects == [7]


@pytest.mark.parametrize("first", [True, False])
def test_linemod_is_opened_for_its_objects(opened, capsys, first):
    options = parsed()
    options.data = "linemod:here"
    open_data(options, JOB._replace(first=first), {})
    assert opened[1] == ("linemod:here", "train", "tiny", {"object_id": [4, 7]})
    assert ("note: linemod names one object" in capsys.readouterr().err) == first
    options.objects = [7]
    open_data(options, JOB, {})
    assert opened[-1][-1] == {"object_id": [7]}
    assert capsys.readouterr().err == ""


def test_the_split_that_is_read_unless_another_is_asked_for(opened, tmp_path):
    """An own object of linemod without lists has none."""
    own = tmp_path / "mug"
    (own / "rgb").mkdir(parents=True)
    for lists, given, expected in (
        ((), (), None),
        (("train", "test"), (), "train"),
        (("train", "test"), ("--split", "test"), "test"),
        (("test",), (), "train"),
    ):
        for name in ("train", "test"):
            (own / f"{name}.txt").unlink(missing_ok=True)
        for name in lists:
            (own / f"{name}.txt").touch()
        options = parsed(*given)
        options.data = f"linemod:{own}"
        open_data(options, JOB, {})
        assert [call[1] for call in opened[-2:]] == [expected] * 2
        assert options.split == expected
    options = parsed()
    open_data(options, JOB, {})
    assert options.split == opened[-1][1] == "train"


@pytest.mark.parametrize(
    "text",
    [
        "[enforce fail at alloc_cpu.cpp:124] err == 0. DefaultCPUAllocator: can't allocate memory",
        "DefaultCPUAllocator: not enough memory: you tried to allocate 7 bytes.",
        "CUDA out of memory. Tried to allocate 7 GiB.",
        "could not create a primitive",
        "could not create a memory object",
    ],
)
def test_what_does_not_fit_is_one_line(text):
    def full(options):
        raise RuntimeError(text + "\nand a trace")

    options = parsed(command=full)
    with pytest.raises(ValueError, match="^--batch: expected one that fits into memory") as refused:
        options.command(options)
    assert "\n" not in str(refused.value)

    def other(options):
        raise RuntimeError("another one")

    options = parsed(command=other)
    with pytest.raises(RuntimeError, match="another one"):
        options.command(options)


def test_data_that_will_not_do(opened, three):
    with pytest.raises(ValueError, match="^--data: expected data with depth, got bop:three with"):
        open_data(parsed(), JOB, {"rgb": "colour images", "depth": "depth"})
    with pytest.raises(ValueError, match=r"^--objects: expected some of 4, 7, which.*got \[5\]"):
        open_data(parsed("--objects", "4", "5"), JOB, {})
    three.object_ids = tuple(range(30))
    with pytest.raises(ValueError, match=r"18, 19, \.\.\., which bop:three has, got \[99\]"):
        open_data(parsed("--objects", "99"), JOB, {})
    three.object_ids = ()
    with pytest.raises(ValueError, match="^--data: expected data with known poses"):
        open_data(parsed(), JOB, {})


def test_two_do_not_train_in_one_folder(tmp_path):
    job = Job(tmp_path / "runs" / "r", "tiny", torch.device("cpu"), 1, True)
    with job.alone():
        with pytest.raises(ValueError, match="^--out: expected .*another process trains there"):
            with job.alone():
                pass
        with job._replace(first=False).alone():  # another process of the same training
            pass
    assert list(tmp_path.iterdir()) == [], "where nothing was written nothing is left"
    with job.alone():
        (job.path / "run.json").touch()
    assert list(job.path.iterdir()) == [job.path / "run.json"]
