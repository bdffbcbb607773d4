"""One split of recordings of AR glasses by three cameras, as views; layout: `data_tools.hmdpose`.

Calibration and tables are read when the dataset is opened, images when they are asked for.
"""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

import numpy as np

from data_tools.bop.files import has_file, has_folder, refuse_broken_link
from data_tools.bop.models import Models
from data_tools.hmdpose.calibration import CAMERAS, Camera, read_calibration
from data_tools.hmdpose.pictures import Pictures
from data_tools.hmdpose.tables import Label, read_labels, read_poses
from data_tools.views import Dataset, ObjectView, View
from posecore.arrays import fail, require_integer
from posecore.metrics.pose_table import PoseTable
from posecore.poses import from_matrix, relative

__all__ = ["HEAD", "HmdposeDataset"]

HEAD = 5  # the object id of the head, as in the world `headset`
POSES, LABELS, CALIBRATION = "poses.csv", "labels.csv", "calibration.json"


class HmdposeDataset(Dataset):
    """The images of one split: of each row of `poses.csv` the left, the centre and the right one.

    `scene_id` is the subject, `image_id` three times the frame and 0, 1 or 2 for the camera, and
    the three views of an instant share the `group` (subject, frame). `T_world_cam` is the camera's
    pose in the car. The objects are the glasses (1 to 4) and, where there are labels of it, the
    head (5), whose pose is that of the glasses.

    Args:
        path: the dataset's folder.
        split: name of the split's folder, such as "train"; None if there is only one.
        width: of the images, if they are to be reduced: 320 reads images of 1280 x 752 as
            320 x 188, as the papers on HMDPose do. `K`, boxes, masks and depth follow.

    Attributes:
        path, split: as above.
        cameras: of the images as they are read, by "left", "centre" and "right".

    Raises:
        ValueError: naming the argument, or the file and what is wrong in it.
    """

    def __init__(
        self, path: str | Path, split: str | None = None, *, width: int | None = None
    ) -> None:
        if not isinstance(path, str | Path) or not Path(path).is_dir():
            fail("path", "the folder of an HMDPose dataset", repr(path))
        self.path = Path(path)
        splits = sorted(p.name for p in self.path.iterdir() if p.is_dir() and has_file(p / POSES))
        if not splits:
            for place in sorted(self.path.iterdir()):
                refuse_broken_link(place)
            fail("path", f"a folder with splits, such as train/{POSES}", repr(str(path)))
        if split is None and len(splits) == 1:
            split = splits[0]
        if split not in splits:
            fail("split", f"one of {', '.join(splits)} in {path}", repr(split))
        self.split: str = split
        if not has_file(self.path / CALIBRATION):
            raise ValueError(f"{self.path / CALIBRATION}: no such file")
        calibration = read_calibration(self.path / CALIBRATION)
        self._own = dict(calibration.cameras)
        if width is not None:
            require_integer("width", width, 1, min(camera.width for camera in self._own.values()))
        self.cameras: dict[str, Camera] = {
            name: camera.resized(camera.width if width is None else width)
            for name, camera in self._own.items()
        }
        folder = self.path / split
        self._poses = read_poses(folder / POSES)
        self._labels: dict[tuple[int, str, str], Label] = {}
        if has_file(folder / LABELS):
            self._labels = read_labels(folder / LABELS, self._poses)
        self._pictures = Pictures(folder, self._poses, folder / POSES)
        self._step = calibration.depth_step
        if "depth" in self._pictures.kinds and self._step is None:
            raise ValueError(f"{self.path / CALIBRATION}: depth_step is missing, as there is depth")
        named = {key[2] for key in self._labels}
        named |= {kind[1] for kind in self._pictures.kinds if isinstance(kind, tuple)}
        self._has_head = "head" in named

    def __len__(self) -> int:
        return len(self._poses) * len(CAMERAS)

    def __getitem__(self, index: int) -> View:
        row, number = divmod(range(len(self))[index], len(CAMERAS))
        name, frame = CAMERAS[number], int(self._poses.frame[row])
        own, camera = self._own[name], self.cameras[name]
        place = name, frame, own, camera
        subject = int(self._poses.subject[row])
        R, t = relative(*from_matrix(camera.T_world_cam), self._poses.R[row], self._poses.t[row])
        pose = {"R": R, "t": t}
        glasses = int(self._poses.glasses[row])
        objects = [self._object(glasses, "glasses", place, pose)]
        if self._has_head:
            objects.append(self._object(HEAD, "head", place, pose))
        try:
            return View(
                K=camera.K,
                scene_id=subject,
                image_id=len(CAMERAS) * frame + number,
                ir=self._pictures.grey(*place),
                depth=self._pictures.depth(*place, self._step),
                T_world_cam=camera.T_world_cam,
                group=(subject, frame),
                objects=tuple(objects),
            )
        except ValueError as error:
            if str(error).startswith(str(self.path)):
                raise
            raise ValueError(f"{self.path / self.split}: {name} {frame}: {error}") from error

    def __repr__(self) -> str:
        return f"HmdposeDataset({str(self.path)!r}, {self.split!r}: {len(self)} images)"

    @property
    def object_ids(self) -> tuple[int, ...]:
        """The objects that occur in the images, in ascending order."""
        worn = np.unique(self._poses.glasses).tolist()
        return (*worn, HEAD) if self._has_head else tuple(worn)

    @property
    def images(self) -> list[tuple[int, int]]:
        """(subject, image id) of every view."""
        frames = zip(self._poses.subject.tolist(), self._poses.frame.tolist(), strict=True)
        return [(s, len(CAMERAS) * f + n) for s, f in frames for n in range(len(CAMERAS))]

    def ground_truth(self) -> PoseTable:
        """The poses of the glasses, in the order of the views; no image is read for it."""
        cameras = [from_matrix(camera.T_world_cam) for camera in self.cameras.values()]
        found = [
            relative(*camera, R, t)
            for R, t in zip(self._poses.R, self._poses.t, strict=True)
            for camera in cameras
        ]
        scene_id, image_id = np.array(self.images, np.int64).T
        return PoseTable(
            scene_id=scene_id,
            image_id=image_id,
            object_id=np.repeat(self._poses.glasses, len(CAMERAS)),
            R=np.array([R for R, _ in found]),
            t=np.array([t for _, t in found]),
            score=np.ones(len(found)),
            time=np.full(len(found), -1.0),
        )

    def camera(self, scene_id: int, image_id: int) -> Camera:
        """The camera of one image.

        Raises:
            ValueError: if the split holds no such image.
        """
        if (scene_id, image_id) not in self._known:
            fail("image_id", f"an image of subject {scene_id} in {self.split}", image_id)
        return self.cameras[CAMERAS[image_id % len(CAMERAS)]]

    def models(self) -> Models:
        """The models of the glasses.

        Raises:
            ValueError: if there is no folder `models`, or it is damaged.
        """
        if self._models is None:
            raise ValueError(f"{self.path}: no models: no folder 'models'")
        return self._models

    @cached_property
    def _models(self) -> Models | None:
        folder = self.path / "models"
        return Models(folder) if has_folder(folder) else None

    @cached_property
    def _known(self) -> set[tuple[int, int]]:
        return set(self.images)

    def _object(
        self, object_id: int, name: str, place: tuple[str, int, Camera, Camera], pose: dict
    ) -> ObjectView:
        camera, frame, own, shown = place
        label = self._labels.get((frame, camera, name), Label())
        size, box = label.size, label.box
        if size is None and self._models is not None and object_id in self._models.ids:
            size = self._models.info(object_id).size
        if box is not None and shown is not own:
            x, y = shown.width / own.width, shown.height / own.height
            box = box * [x, y, x, y]
        return ObjectView(
            object_id=object_id,
            category=name,
            box=box,
            mask=self._pictures.mask("masks", name, *place),
            full_mask=self._pictures.mask("full_masks", name, *place),
            visible_fraction=label.visible_fraction,
            size=size,
            **pose,
        )
