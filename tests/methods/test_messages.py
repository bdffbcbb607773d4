"""What the command line says of options and files: by the names that they have there."""

import json

import pytest
import torch

from data_tools.bop.files import read_json
from posecore.methods.main import main
from posecore.methods.runs import _few_names
from posecore.nets.resnet import _state_dict

ROW = "1,1,1,1,1 0 0 0 1 0 0 0 1,0 0 1000,-1\n"
HEADER = "scene_id,im_id,obj_id,score,R,t,time\n"


def refused(capsys, *words):
    assert main([str(word) for word in words]) == 2
    return capsys.readouterr().err


@pytest.fixture
def estimates(tmp_path):
    path = tmp_path / "est.csv"
    path.write_text(HEADER + ROW)
    return path


def test_evaluate_names_its_options(tmp_path, estimates, capsys):
    nowhere = tmp_path / "nowhere"
    cases = [
        ("error: --models: expected a folder", estimates, "--models", nowhere),
        ("error: GROUND_TRUTH: expected the folder of a BOP", f"bop:{nowhere}"),
        ("error: GROUND_TRUTH: expected the folder of LINEMOD", f"linemod:{nowhere}"),
        ("error: GROUND_TRUTH: expected a CSV file that is there, bop:PATH", "tabletop"),
    ]
    for beginning, *words in cases:
        assert refused(capsys, "evaluate", estimates, *words).startswith(beginning)


def test_ground_truth_of_a_header_alone_is_named(tmp_path, estimates, capsys):
    truth, models = tmp_path / "gt.csv", tmp_path / "models"
    truth.write_text(HEADER)
    models.mkdir()
    said = refused(capsys, "evaluate", estimates, truth, "--models", models)
    assert said == f"error: {truth}: expected true poses, got none\n"


def test_train_names_its_options(tmp_path, capsys):
    words = ["train", "vector_field", "--out", tmp_path / "r", "--data"]
    assert refused(capsys, *words, "nodata").startswith("error: --data: expected ")
    assert refused(capsys, *words, f"bop:{tmp_path / 'no'}").startswith("error: --data: expected ")
    said = refused(capsys, *words, "tabletop", "--projection", "none", "--weight", "3")
    assert said.startswith("error: --weight: expected nothing, as --projection none")


@pytest.mark.parametrize("system", ["OPEPL", "OPEPL-R"])
def test_a_threshold_without_effect_is_refused(tmp_path, capsys, system):
    words = ["--run", tmp_path, "--data", "tabletop", "--output", tmp_path / "o.csv"]
    said = refused(
        capsys, "estimate", "vector_field", *words, "--system", system, "--threshold", "0.5"
    )
    assert said.startswith("error: --threshold: expected nothing, as " + system)


def test_a_run_without_an_entry_is_said_in_words(tmp_path, capsys):
    words = ["--run", tmp_path, "--data", "tabletop", "--output", tmp_path / "o.csv"]
    for content, said in (({}, "method: expected an entry"), ([1], "method: expected an entry"),
                          ({"method": "vector_field", "options": {}}, "no entry '")):  # fmt: skip
        (tmp_path / "run.json").write_text(json.dumps(content))
        assert read_json(tmp_path / "run.json") == content
        err = refused(capsys, "estimate", "vector_field", *words)
        assert f"run.json: damaged: {said}" in err and "KeyError" not in err


def test_of_another_network_a_few_names_are_said():
    one, other = torch.nn.Linear(1, 1), torch.nn.Sequential(*[torch.nn.Linear(1, 1)] * 200)
    with pytest.raises(RuntimeError) as caught:
        one.load_state_dict(other.state_dict())
    words = _few_names(" ".join(str(caught.value).split()))
    assert "and 397 more" in words and len(words) < 400


@pytest.mark.parametrize("junk", [b"hello, world", b"{}", b"", b"\x80\x02cos\nsystem\nq\x00."])
def test_no_advice_to_run_what_is_in_a_file(tmp_path, junk):
    path = tmp_path / "junk.pth"
    path.write_bytes(junk)
    with pytest.raises(ValueError, match=r"junk\.pth") as caught:
        _state_dict(path)
    assert "weights_only" not in str(caught.value)
