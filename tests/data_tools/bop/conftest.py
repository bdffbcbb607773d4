"""A small data set in BOP's layout, written from plain numbers that tests compare with."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

HEIGHT, WIDTH = 12, 16


class Tree:
    """The data set in `path`; the JSON files are kept as objects that a test changes and saves."""

    def __init__(self, path: Path):
        self.path = path
        rng = np.random.default_rng(7)
        self.rgb, self.grey, self.depth, self.masks, self.json = {}, {}, {}, {}, {}
        self.K = [100.5, 0, 7.5, 0, 101.25, 5.5, 0, 0, 1]
        self.R = Rotation.random(3, random_state=1).as_matrix()
        self.t = [[10.5, -20.25, 700.125], [0.5, 0.25, 512], [-100, 50, 1000]]
        # Scene 1 has everything; the ids say that "10" comes after "4".
        for image in (4, 10):
            self.image(1, "rgb", image, rng.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8))
            self.image(1, "depth", image, rng.integers(0, 65536, (HEIGHT, WIDTH), np.uint16))
            for number in range(3 if image == 4 else 1):
                for kind in ("mask", "mask_visib"):
                    self.image(1, kind, f"{image:06d}_{number:06d}", self.mask(rng))
        w2c = {"cam_R_w2c": self.R[2].ravel().tolist(), "cam_t_w2c": [1000, 0, -500]}
        self.json["test/000001/scene_camera"] = {
            "10": {"cam_K": self.K, "depth_scale": 0.1, **w2c},
            "4": {"cam_K": self.K, "depth_scale": 0.1},
        }
        self.json["test/000001/scene_gt"] = {
            "10": [self.pose(2, 0)],
            "4": [self.pose(1, 0), self.pose(2, 1), self.pose(2, 2)],
        }
        seen = {"bbox_visib": [3, 4, 5, 6], "visib_fract": 0.75}
        hidden = {"bbox_visib": [-1, -1, -1, -1], "visib_fract": 0.0}
        self.json["test/000001/scene_gt_info"] = {"10": [seen], "4": [seen, hidden, seen]}
        # Scene 12 is grey and has neither depth nor masks nor infos; its poses are secret.
        self.image(12, "gray", 0, rng.integers(0, 256, (HEIGHT, WIDTH), np.uint8), ".tif")
        self.json["test/000012/scene_camera"] = {"0": {"cam_K": self.K}}
        # A second split, with JPEG images.
        smooth = np.full((HEIGHT, WIDTH, 3), (200, 100, 50), np.uint8)
        self.image(0, "rgb", 0, smooth, ".jpg", split="train_pbr")
        self.json["train_pbr/000000/scene_camera"] = {"0": {"cam_K": self.K}}
        self.json["train_pbr/000000/scene_gt"] = {"0": []}

        box = trimesh.creation.box((100, 60, 40))
        self.vertices = {i: np.add(box.vertices, [0, 0, 5 * i]) for i in (1, 2, 3)}
        self.faces = np.asarray(box.faces)
        for i, encoding in ((1, "ascii"), (2, "binary"), (3, "ascii")):
            mesh = trimesh.Trimesh(self.vertices[i], self.faces, process=False)
            self.write(f"models/obj_{i:06d}.ply", mesh.export(file_type="ply", encoding=encoding))
        corner = {"min_x": -50, "min_y": -30, "min_z": -15, "size_x": 100, "size_y": 60}
        flip = [-1, 0, 0, 4, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
        turn = {"axis": [0, 0, 2], "offset": [10, 20, 0]}
        self.json["models/models_info"] = {
            "1": {"diameter": 123.5, **corner, "size_z": 40, "symmetries_continuous": [turn]},
            "2": {"diameter": 123.5, **corner, "size_z": 40, "symmetries_discrete": [flip]},
        }
        self.json["test_targets"] = [
            {"scene_id": 1, "im_id": 4, "obj_id": 2, "inst_count": 2},
            {"scene_id": 12, "im_id": 0, "obj_id": 1, "inst_count": 1},
        ]
        self.save()

    def pose(self, object_id, i):
        matrix = self.R[i].ravel().tolist()
        return {"obj_id": object_id, "cam_R_m2c": matrix, "cam_t_m2c": self.t[i]}

    def mask(self, rng):
        return (rng.random((HEIGHT, WIDTH)) < 0.5).astype(np.uint8) * 255

    def image(self, scene, kind, name, pixels, suffix=".png", split="test"):
        stem = f"{name:06d}" if isinstance(name, int) else name
        stored = pixels[..., ::-1] if pixels.ndim == 3 else pixels
        self.write(
            f"{split}/{scene:06d}/{kind}/{stem}{suffix}", cv2.imencode(suffix, stored)[1].tobytes()
        )
        store = {"rgb": self.rgb, "gray": self.grey, "depth": self.depth}.get(kind, self.masks)
        store[(kind, stem) if store is self.masks else (scene, name)] = pixels

    def write(self, name, data: bytes) -> Path:
        file = self.path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)
        return file

    def cut(self, name, keep: float) -> Path:
        """Cut a file to a share of its length."""
        data = (self.path / name).read_bytes()
        return self.write(name, data[: int(len(data) * keep)])

    def remove(self, name) -> None:
        (self.path / name).unlink()

    def save(self) -> None:
        for name, content in self.json.items():
            self.write(f"{name}.json", json.dumps(content).encode())


@pytest.fixture(scope="session")
def toy(tmp_path_factory) -> Tree:
    """The data set for property tests, which leave it as it was."""
    return Tree(tmp_path_factory.mktemp("session") / "toy")


@pytest.fixture
def tree(tmp_path) -> Tree:
    return Tree(tmp_path / "toy")
