import pytest
import torch

from data_tools import batches
from data_tools.batches import memory
from data_tools.batches.files import CHUNK_SIZE
from data_tools.batches.memory import BYTES, machine_memory, require_room
from tests.data_tools.batches.conftest import Listed, make_view


def test_the_machine_has_memory():
    assert 2**28 < machine_memory() < 2**50


def test_what_fits_and_what_does_not(monkeypatch):
    monkeypatch.setattr(memory, "machine_memory", lambda: 100 * 64 * BYTES)
    require_room("rows", 100, (8, 8))
    with pytest.raises(ValueError, match="^rows: expected a batch that fits into .* 101 images of"):
        require_room("rows", 101, (8, 8))
    with pytest.raises(ValueError, match="^rows: "):
        require_room("rows", 100, (8, 8), BYTES + 1)


def test_a_dataset_that_does_not_fit(monkeypatch):
    """It is seen from the first piece, before the others are read."""
    dataset = Listed([make_view(index) for index in range(CHUNK_SIZE + 1)])
    monkeypatch.setattr(memory, "machine_memory", lambda: (CHUNK_SIZE + 1) * 24 * 32 * 4)
    assert len(batches.load(dataset, progress=False)) == CHUNK_SIZE + 1 == dataset.asked
    dataset.asked = 0
    monkeypatch.setattr(memory, "machine_memory", lambda: CHUNK_SIZE * 24 * 32 * 4)
    with pytest.raises(ValueError, match="^dataset: expected images that fit into .* 65 images"):
        batches.load(dataset, progress=False)
    assert dataset.asked == CHUNK_SIZE


@pytest.mark.parametrize("limit", ["max\n", "", "4096\n", "1" + "0" * 30])
def test_the_limit_of_a_container(tmp_path, monkeypatch, limit):
    (tmp_path / "limit").write_text(limit)
    monkeypatch.setattr(memory, "LIMITS", (str(tmp_path / "limit"), str(tmp_path / "nowhere")))
    found = memory.machine_memory.__wrapped__()
    assert found == (4096 if limit == "4096\n" else machine_memory())


@pytest.mark.slow
def test_batches_that_do_not_fit(stack_of):
    stack = stack_of("tabletop")
    rows = stack.rows()
    for call, name in (
        (lambda: stack.crops(rows[:1], 10**6), "size"),
        (lambda: stack.crops(rows[:2], 10**6), "rows"),
        (lambda: stack.frames(torch.arange(1), (10**6, 10**6)), "size"),
        (lambda: stack.frames(torch.arange(2), 10**6), "views"),
    ):
        with pytest.raises(ValueError, match=f"^{name}: expected a batch that fits into"):
            call()
