"""Where the files of a scene are, with one sensor or with several.

    SPLIT/000002/{rgb,gray,depth,mask,mask_visib}/, scene_camera.json, scene_gt.json, ...
    SPLIT/000002/{rgb,gray,depth,mask,mask_visib}_cam1/, scene_camera_cam1.json, ...
    SPLIT/000002/{gray1,mask_gray1,mask_visib_gray1}/, scene_camera_gray1.json, ...

The second is how BOP's industrial datasets (IPD, XYZ-IBD, ITODD-MV) name several sensors, the third
HOT3D: BOP toolkit, bop_toolkit_lib/dataset_params.py.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from data_tools.bop.files import has_folder
from posecore.arrays import fail

__all__ = ["SceneFiles", "choose_sensor", "find_scenes", "number_of"]

CAMERAS = "scene_camera"
KINDS = ("rgb", "gray", "depth", "mask", "mask_visib")


@dataclass(frozen=True)
class SceneFiles:
    """The files of one scene that belong to a sensor.

    Attributes:
        folder: of the scene.
        sensor: its name, "" where files have no other.
    """

    folder: Path
    sensor: str = ""

    def json(self, name: str) -> Path:
        """The file `scene_camera`, `scene_gt` or `scene_gt_info`."""
        return self.folder / f"{self._named(name)}.json"

    def images(self, kind: str) -> Path | None:
        """The folder of "rgb", "gray", "depth", "mask" or "mask_visib"; None if there is none.

        Raises:
            ValueError: if it is a link that leads nowhere.
        """
        names = [self._named(kind)]
        if self.sensor.startswith(kind):  # HOT3D's sensors are called by what they see: gray1
            names.append(self.sensor)
        return next((path for n in names if has_folder(path := self.folder / n)), None)

    def _named(self, name: str) -> str:
        return f"{name}_{self.sensor}" if self.sensor else name


def number_of(name: str) -> int | None:
    """The number that a file's or folder's name is, such as 000002; None if it is none."""
    match = re.fullmatch("0{0,80}[0-9]{1,18}", name)
    return None if match is None else int(name)


def find_scenes(folder: Path) -> dict[int, Path]:
    """The scenes of a split by their ids: the folders with a number for a name.

    Raises:
        ValueError: if two have the same number, or one is a link that leads nowhere.
    """
    numbered = ((number_of(p.name), p) for p in folder.iterdir())
    found = sorted((n, p) for n, p in numbered if n is not None and has_folder(p))
    if len(dict(found)) < len(found):
        raise ValueError(f"{folder}: two folders of one scene, {[p.name for _, p in found]}")
    return dict(found)


def choose_sensor(scenes: dict[int, Path], sensor: str | None) -> dict[int, SceneFiles]:
    """The files of the scenes in which a sensor was there.

    Args:
        scenes: of a split, at least one.
        sensor: its name; None for files without one or, if there are none, for the only sensor.

    Raises:
        ValueError: if there is no such sensor, or several and none is chosen.
    """
    of_scene = {scene_id: _sensors(path) for scene_id, path in scenes.items()}
    known = sorted(set().union(*of_scene.values()))
    if sensor is None and "" not in known and known:
        if len(known) > 1:
            expected = f"one of {', '.join(known)}, such as split 'test:{known[0]}' has"
            fail("sensor", expected, "None")
        sensor = known[0]
    if sensor is not None and sensor not in known:
        named = [name for name in known if name]
        expected = f"one of {', '.join(named)}" if named else "None, as files name no sensor"
        fail("sensor", expected, repr(sensor))
    if not sensor:  # a scene without cameras is not left out but refused
        return {scene_id: SceneFiles(path) for scene_id, path in scenes.items()}
    there = (scene_id for scene_id, names in of_scene.items() if sensor in names)
    return {scene_id: SceneFiles(scenes[scene_id], sensor) for scene_id in there}


def _sensors(folder: Path) -> Iterable[str]:
    """The sensors of a scene, "" for files that name none."""
    names = (p.stem for p in folder.glob(f"{CAMERAS}*.json"))
    return {name[len(CAMERAS) + 1 :] for name in names if name == CAMERAS or name[12] == "_"}
