"""Mistakes made in a dataset on disk: each a function of its folder."""

import json

import cv2
import numpy as np
import trimesh

from data_tools.bop.ply import read_ply


def change(folder, name, function):
    """Put every entry of the images' JSON files through a function."""
    for path in sorted(folder.glob(f"test/*/{name}.json")):
        entries = json.loads(path.read_text())
        for image in entries.values():
            for entry in image if isinstance(image, list) else [image]:
                function(entry)
        path.write_text(json.dumps(entries))


def poses(folder, function, only=None):
    """`function(R, t)` of every pose, of one object if `only` says which."""

    def changed(entry):
        if only is None or entry["obj_id"] == only:
            R = np.reshape(entry["cam_R_m2c"], (3, 3))
            R, t = function(R, np.array(entry["cam_t_m2c"]))
            entry["cam_R_m2c"], entry["cam_t_m2c"] = R.ravel().tolist(), t.tolist()

    change(folder, "scene_gt", changed)


def cameras(folder, function):
    """`function(K)` of every camera."""

    def changed(entry):
        entry["cam_K"] = function(np.reshape(entry["cam_K"], (3, 3))).ravel().tolist()

    change(folder, "scene_camera", changed)


def models(folder, factor, only=None, infos=False):
    """Scale the meshes, and what is said of them if `infos`."""
    for path in sorted((folder / "models").glob("obj_*.ply")):
        if only is None or path.stem == f"obj_{only:06d}":
            mesh = read_ply(path)
            mesh = trimesh.Trimesh(mesh.vertices * 1000 * factor, mesh.faces, process=False)
            path.write_bytes(mesh.export(file_type="ply"))
    path = folder / "models" / "models_info.json"
    entries = json.loads(path.read_text())
    for object_id, entry in entries.items():
        if infos and only in (None, int(object_id)):
            for key in entry:
                if not key.startswith("symmetries"):
                    entry[key] *= factor
    path.write_text(json.dumps(entries))


def images(folder, function, kinds=("rgb", "depth", "mask", "mask_visib")):
    """`function(image)` of every picture."""
    for kind in kinds:
        for path in sorted(folder.glob(f"test/*/{kind}/*")):
            image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            cv2.imwrite(str(path), function(image))


def renamed(folder, kind, new_name):
    """Give the files of a folder each the content of another: `new_name(stem, stems)`."""
    for place in sorted(folder.glob(f"test/*/{kind}")):
        content = {path.stem: path.read_bytes() for path in sorted(place.iterdir())}
        for stem in content:
            (place / f"{new_name(stem, list(content))}.png").write_bytes(content[stem])


def moved(image, x, y):
    """An image cut out so that all lies (x, y) pixels farther right and down; black comes in."""
    to = np.float32([[1, 0, x], [0, 1, y]])
    size = image.shape[1], image.shape[0]
    return cv2.warpAffine(image, to, size, flags=cv2.INTER_NEAREST)


def of_next(stem, stems):
    """The image after it has its content; the first one that of the last."""
    return stems[(stems.index(stem) + 1) % len(stems)]


def of_other_object(stem, stems):
    """The next object in the same image has its mask."""
    image = stem.split("_")[0]
    return of_next(stem, [one for one in stems if one.startswith(image)])
