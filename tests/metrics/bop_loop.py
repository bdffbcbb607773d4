"""BOP's average recall as its challenges define it, in the plainest loops and one pair at a time.

Written from the published rule (Hodan et al., BOP Challenge 2020, and the toolkit's behaviour): the
estimates of an object in an image, the surest first and as many as there are targets, each take the
free valid pose with the smallest error below the threshold; recall is the share of valid poses that
were taken, averaged over the thresholds.
"""

import numpy as np

THRESHOLDS = {"mssd": [0.05 * k for k in range(1, 11)], "mspd": [5.0 * k for k in range(1, 11)]}


def error(name, K, est, gt, model):
    """MSSD or MSPD of one estimate (R, t) and one true pose (R, t)."""
    symmetries = np.eye(4)[None] if model.symmetries is None else model.symmetries
    best = np.inf
    for S in symmetries:
        there = (model.points @ S[:3, :3].T + S[:3, 3]) @ gt[0].T + gt[1]
        here = model.points @ est[0].T + est[1]
        if name == "mspd":
            here, there = ((x @ K.T)[:, :2] / x[:, 2:] for x in (here, there))
        best = min(best, np.linalg.norm(here - there, axis=1).max())
    return best


def average_recall(name, estimates, poses, valid, counts, models, K, width):
    """In [0, 1].

    Args:
        name: "mssd" or "mspd".
        estimates: a list of dicts with image, object, score, R, t.
        poses: the same for all poses of the images, targets or not, without scores.
        valid: for each of the poses whether it may be taken.
        counts: (image, object) -> how many estimates are looked at.
        models: object -> model with points, diameter, symmetries.
        K, width: of all images.
    """
    recalls = []
    for threshold in THRESHOLDS[name]:
        taken = set()
        for (image, object_id), count in counts.items():
            mine = [e for e in estimates if (e["image"], e["object"]) == (image, object_id)]
            for e in sorted(mine, key=lambda e: e["score"], reverse=True)[:count]:
                best, best_error = None, threshold
                for number, pose in enumerate(poses):
                    if (pose["image"], pose["object"]) != (image, object_id):
                        continue
                    if not valid[number] or number in taken:
                        continue
                    model = models[object_id]
                    gap = error(name, K, (e["R"], e["t"]), (pose["R"], pose["t"]), model)
                    gap /= model.diameter if name == "mssd" else width / 640
                    if gap < best_error:
                        best, best_error = number, gap
                if best is not None:
                    taken.add(best)
        recalls.append(len(taken) / sum(valid))
    return np.mean(recalls)
