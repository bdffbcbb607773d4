"""Training batches beside what one would use in their place. `pytest -n 0 tests/bench/bench_*.py`.

128 crops of 128 x 128 from tabletop at book scale (320 x 240), on two threads. kornia and
albumentations are measured where they import; they do the same kinds of changes to image and mask,
but neither poses nor camera matrices, neither depth nor things in front of the object.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from data_tools import batches
from data_tools.views import Dataset, View
from data_tools.worlds import tabletop

COUNT, SIZE = 128, 128


class First(Dataset):
    """The first views of a dataset."""

    def __init__(self, dataset: Dataset, count: int) -> None:
        self.views = [dataset[i] for i in range(count)]
        self.object_ids = dataset.object_ids

    object_ids: tuple[int, ...] = ()

    def __len__(self) -> int:
        return len(self.views)

    def __getitem__(self, index: int) -> View:
        return self.views[index]

    def models(self) -> None:
        raise ValueError


@pytest.fixture(scope="module")
def stack():
    """64 views, rendered the first time."""
    dataset = tabletop.WORLD.open(split="train", scale="book", whole=False)
    return batches.load(First(dataset, 64), progress=False)


@pytest.fixture
def two_threads():
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def rows(stack):
    return stack.rows(visible=0.3).repeat(2)[:COUNT]


@pytest.fixture(scope="module")
def images(stack, rows):
    """The images and masks around the objects, twice as wide as the crops show, as bytes."""
    batch = stack.crops(rows, 2 * SIZE, margin=2.5)
    images = (255 * batch["rgb"]).round().to(torch.uint8).contiguous()
    return images, batch["mask"]


PARTS = {
    "all": {},
    "nothing": {"augment": None},
    "geometry": dict.fromkeys(
        "background occluder light colour blur noise depth_noise holes".split(), 0.0
    ),
    "no composing": {"background": 0.0, "occluder": 0.0},
}


@pytest.mark.parametrize("part", PARTS)
def test_crops(benchmark, two_threads, stack, rows, part):
    benchmark.group = "a batch of 128 crops"
    options = PARTS[part]
    augment = None if "augment" in options else batches.Augmentation(**options)
    generator = torch.Generator().manual_seed(0)
    benchmark(lambda: stack.crops(rows, SIZE, augment=augment, generator=generator))
    benchmark.extra_info["crops per second"] = round(COUNT / benchmark.stats["median"])


def test_grid_sample(benchmark, two_threads, images):
    """The warp alone, of image and mask, in PyTorch."""
    benchmark.group = "a batch of 128 crops"
    colours, mask = images
    angle = torch.rand(COUNT, generator=torch.Generator().manual_seed(0)) - 0.5
    c, s, zero = torch.cos(angle) / 2, torch.sin(angle) / 2, torch.zeros(COUNT)
    theta = torch.stack([c, -s, zero, s, c, zero], 1).reshape(-1, 2, 3)

    def warp() -> torch.Tensor:
        grid = F.affine_grid(theta, [COUNT, 3, SIZE, SIZE], align_corners=False)
        F.grid_sample(mask[:, None].float(), grid, "nearest", align_corners=False)
        return F.grid_sample(colours.float() / 255, grid, align_corners=False)

    assert benchmark(warp).shape == (COUNT, 3, SIZE, SIZE)


def test_kornia(benchmark, two_threads, images):
    benchmark.group = "a batch of 128 crops"
    kornia = pytest.importorskip("kornia.augmentation", reason="kornia is not installed")
    colours, mask = images
    augment = kornia.AugmentationSequential(
        kornia.RandomAffine(30, (0.05, 0.05), (1.6, 2.5), p=1),
        kornia.CenterCrop(SIZE, p=1),
        kornia.ColorJiggle(0.25, 0.25, 0.15, 0.02, p=1),
        kornia.RandomGamma((0.8, 1.25), p=1),
        kornia.RandomGaussianBlur((5, 5), (0.1, 1.2), p=1),
        kornia.RandomGaussianNoise(0, 0.015, p=1),
        kornia.RandomErasing((0.05, 0.2), p=0.5),
        data_keys=["input", "mask"],
    )
    out, _ = benchmark(lambda: augment(colours.float() / 255, mask[:, None].float()))
    assert out.shape == (COUNT, 3, SIZE, SIZE)


def test_albumentations(benchmark, two_threads, images):
    benchmark.group = "a batch of 128 crops"
    library = pytest.importorskip("albumentations", reason="albumentations is not installed")
    colours = np.ascontiguousarray(images[0].permute(0, 2, 3, 1).numpy())
    mask = images[1].numpy().astype(np.uint8)
    augment = library.Compose(
        [
            library.Affine(scale=(1.6, 2.5), translate_percent=0.05, rotate=(-30, 30), p=1),
            library.CenterCrop(SIZE, SIZE),
            library.ColorJitter(0.25, 0.25, 0.15, 0.02, p=1),
            library.RandomGamma((80, 125), p=1),
            library.GaussianBlur(sigma_limit=(0.1, 1.2), p=1),
            library.GaussNoise(std_range=(0.0, 0.03), p=1),
            library.CoarseDropout(p=0.5),
        ]
    )

    def run() -> torch.Tensor:
        done = [augment(image=i, mask=m)["image"] for i, m in zip(colours, mask, strict=True)]
        return torch.from_numpy(np.stack(done)).permute(0, 3, 1, 2).float() / 255

    assert benchmark(run).shape == (COUNT, 3, SIZE, SIZE)


def test_open(benchmark, tmp_path, two_threads):
    """A split of 1200 views, the second time."""
    from data_tools.worlds import headset

    benchmark.group = "open"
    dataset = headset.WORLD.open(split="test", scale="book")
    batches.load(dataset, folder=tmp_path)
    benchmark(lambda: batches.load(dataset, folder=tmp_path))
