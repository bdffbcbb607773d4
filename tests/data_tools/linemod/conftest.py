"""Small data sets in every layout, from plain numbers that tests compare with."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
import yaml
from scipy.spatial.transform import Rotation

HEIGHT, WIDTH = 12, 16
IMAGES = {"train": (0, 12), "test": (3, 7)}
SIDES = {1: (90, 60, 40), 2: (60, 80, 20), 6: (50, 70, 30), 10: (40, 30, 20)}  # millimetres


class Folder:
    """A data set in `path`, and in dictionaries what was written there: by object id and image."""

    def __init__(self, path: Path):
        self.path = path
        self.rng = np.random.default_rng(7)
        self.R = Rotation.random(16, random_state=1).as_matrix()
        self.t = self.rng.uniform(-0.1, 0.1, (16, 3)) + [0, 0, 1]
        self.rgb, self.depth, self.mask = {}, {}, {}

    def write(self, name: str, data: bytes | str) -> Path:
        file = self.path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data if isinstance(data, bytes) else data.encode())
        return file

    def image(self, name: str, pixels: np.ndarray) -> None:
        stored = pixels[..., ::-1] if pixels.ndim == 3 else pixels
        self.write(name, cv2.imencode(Path(name).suffix, stored)[1].tobytes())

    def pictures(self, object_id: int, image: int, rgb: str, mask: str, channels: int) -> None:
        """A smooth picture, which survives JPEG, and a random mask of one or three channels."""
        colour = self.rng.integers(0, 256, 3).astype(np.uint8)
        self.rgb[object_id, image] = np.tile(colour, (HEIGHT, WIDTH, 1))
        self.mask[object_id, image] = self.rng.random((HEIGHT, WIDTH)) < 0.5
        self.image(rgb, self.rgb[object_id, image])
        pixels = self.mask[object_id, image] * np.uint8(255)
        self.image(mask, np.tile(pixels[..., None], 3) if channels == 3 else pixels)

    def pose(self, name: str, image: int) -> None:
        file = self.write(name, b"")
        np.save(file, np.column_stack([self.R[image], self.t[image]]))

    def entry(self, object_id: int, image: int) -> dict:
        """A pose as `gt.yml` has it."""
        return {
            "cam_R_m2c": self.R[image].ravel().tolist(),
            "cam_t_m2c": (self.t[image] * 1000).tolist(),
            "obj_bb": [image, 2, 5, 6],
            "obj_id": object_id,
        }

    def mesh(self, name: str, object_id: int, unit: float, shift: tuple = (0, 0, 0)) -> None:
        mesh = trimesh.creation.box(np.array(SIDES[object_id]) * unit)
        mesh.apply_translation(shift)
        self.write(name, mesh.export(file_type="ply", encoding="ascii"))

    def edit(self, name: str, old: str, new: str) -> None:
        """Change one place in a text file."""
        text = (self.path / name).read_text()
        assert text.count(old) == 1, (name, old, text.count(old))
        self.write(name, text.replace(old, new))

    def cut(self, name: str, keep: float) -> None:
        """Cut a file to a share of its length."""
        data = (self.path / name).read_bytes()
        self.write(name, data[: int(len(data) * keep)])

    def remove(self, name: str) -> None:
        (self.path / name).unlink()


def make_pvnet(path: Path) -> Folder:
    """The cat and the eggbox as PVNet has them, the origin of the cat's frame beside its middle."""
    made = Folder(path)
    for name, object_id in (("cat", 6), ("eggbox", 10)):
        for split, images in IMAGES.items():
            lines = [f"LINEMOD/{name}/JPEGImages/{image:06d}.jpg\n" for image in images]
            made.write(f"{name}/{split}.txt", "".join(lines))
            for image in images:
                rgb, mask = f"JPEGImages/{image:06d}.jpg", f"mask/{image:04d}.png"
                made.pictures(object_id, image, f"{name}/{rgb}", f"{name}/{mask}", 3)
                made.pose(f"{name}/pose/pose{image}.npy", image)
        made.mesh(f"{name}/{name}.ply", object_id, 0.001, (0.001, 0.002, 0.003))
        made.write(f"{name}/farthest.txt", "0.01 0.02 0.03\n-1e-2 0 2.5e-2\n")
    made.write("fuse/0_rgb.jpg", b"not looked at")
    return made


def make_own(path: Path) -> Folder:
    made = Folder(path)
    for image in (0, 2, 10):
        made.pictures(1, image, f"rgb/{image}.jpg", f"mask/{image}.png", 1)
        made.pose(f"pose/{image}.npy" if image == 2 else f"pose/pose{image}.npy", image)
    made.mesh("model.ply", 1, 0.001)
    made.write("camera.txt", "600 0 7.5\n0 601.5 5.5\n0 0 1\n\n")
    made.write("diameter.txt", "0.12\n")
    return made


def make_densefusion(path: Path) -> Folder:
    """Objects 1 and 2; in the images of 2 stands 1 as well."""
    made = Folder(path)
    made.K = {image: [600.0 + image, 0, 7.5, 0, 601, 5.5, 0, 0, 1] for image in range(16)}
    for object_id in (1, 2):
        poses, infos = {}, {}
        for split, images in IMAGES.items():
            # As the public lists end, without a line end.
            text = "\n".join(f"{image:04d}" for image in images)
            made.write(f"data/{object_id:02d}/{split}.txt", text)
            for image in images:
                stem, folder = f"{image:04d}.png", f"data/{object_id:02d}"
                made.pictures(object_id, image, f"{folder}/rgb/{stem}", f"{folder}/mask/{stem}", 3)
                depth = made.rng.integers(0, 65536, (HEIGHT, WIDTH)).astype(np.uint16)
                made.depth[object_id, image] = depth
                made.image(f"{folder}/depth/{stem}", depth)
                found = ~made.mask[object_id, image] * np.uint8(255)
                results = f"segnet_results/{object_id:02d}_label"
                made.image(f"{results}/{image:04d}_label.png", found)
                beside = [made.entry(1, 15)] if object_id == 2 else []
                poses[image] = [*beside, made.entry(object_id, image)]
                infos[image] = {"cam_K": made.K[image], "depth_scale": 1.0}
        made.write(f"data/{object_id:02d}/gt.yml", yaml.safe_dump(poses))
        made.write(f"data/{object_id:02d}/info.yml", yaml.safe_dump(infos))
        made.mesh(f"models/obj_{object_id:02d}.ply", object_id, 1)
    made.write(
        "models/models_info.yml",
        "1: {diameter: 115.5, min_x: -45.0, min_y: -30.0, min_z: -20.0, "
        "size_x: 90.0, size_y: 60.0, size_z: 40.0}\n"
        "2: {diameter: 102.0, min_x: -30, min_y: -40, min_z: -10, size_x: 60, size_y: 80, "
        "size_z: 20}\n",
    )
    return made


@pytest.fixture
def pvnet(tmp_path) -> Folder:
    return make_pvnet(tmp_path / "LINEMOD")


@pytest.fixture
def own(tmp_path) -> Folder:
    return make_own(tmp_path / "mug")


@pytest.fixture
def densefusion(tmp_path) -> Folder:
    return make_densefusion(tmp_path / "Linemod_preprocessed")


@pytest.fixture(scope="session")
def all_layouts(tmp_path_factory) -> list[Folder]:
    """One of each for property tests, which leave them as they were."""
    root = tmp_path_factory.mktemp("linemod")
    return [
        make_pvnet(root / "pvnet"),
        make_own(root / "mug"),
        make_densefusion(root / "densefusion"),
    ]
