"""BOP's scores as its challenges define them, in the plainest loops and one pair at a time.

Written from the published rules (Hodan et al., BOP Challenge 2020; Nguyen et al., BOP Challenge
2024; and the toolkit's behaviour). Localisation: the estimates of an object in an image, the surest
first and as many as there are targets, each take the free valid pose with the smallest error below
the threshold; recall is the share of valid poses that were taken, averaged over the thresholds.
Detection: all estimates take poses in the same way, also such as do not count; what took one of
these is left out, and so are estimates of objects that their image does not hold.
"""

import math

import numpy as np

THRESHOLDS = {
    "mssd": [0.05 * k for k in range(1, 11)],
    "mspd": [5.0 * k for k in range(1, 11)],
    "vsd": np.arange(0.05, 0.51, 0.05).tolist(),
}
TAUS = np.arange(0.05, 0.51, 0.05).tolist()


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


def vsd(depth_est, depth_gt, depth_test, K, diameter, delta, taus):
    """VSD for each of taus, pixel by pixel."""
    union, wrong = 0, [0] * len(taus)
    for y, x in np.argwhere((depth_est > 0) | (depth_gt > 0)).tolist():
        ray = math.hypot((x - K[0][2]) / K[0][0], (y - K[1][2]) / K[1][1], 1)
        est, gt, test = (ray * float(d[y, x]) for d in (depth_est, depth_gt, depth_test))
        gt_seen = gt > 0 and (test == 0 or gt - test <= delta)
        est_seen = est > 0 and (test == 0 or est - test <= delta or gt_seen)
        if gt_seen or est_seen:
            union += 1
            for k, tau in enumerate(taus):
                if not (gt_seen and est_seen) or abs(gt - est) / diameter >= tau:
                    wrong[k] += 1
    return [count / union if union else 1.0 for count in wrong]


def recall(gap, threshold, estimates, poses, valid, counts):
    """At one threshold, in [0, 1].

    Args:
        gap: `gap(estimate, pose)` by their numbers, in the unit of the threshold.
        threshold: an error must be below it.
        estimates: a list of dicts with image, object, score.
        poses: the same for all poses of the images, targets or not, without scores.
        valid: for each of the poses whether it may be taken.
        counts: (image, object) -> how many estimates are looked at.
    """
    taken = set()
    for (image, object_id), count in counts.items():
        mine = [
            k for k, e in enumerate(estimates) if (e["image"], e["object"]) == (image, object_id)
        ]
        for k in sorted(mine, key=lambda k: estimates[k]["score"], reverse=True)[:count]:
            best, best_error = None, threshold
            for number, pose in enumerate(poses):
                if (pose["image"], pose["object"]) != (image, object_id):
                    continue
                if valid[number] and number not in taken and gap(k, number) < best_error:
                    best, best_error = number, gap(k, number)
            if best is not None:
                taken.add(best)
    return len(taken) / sum(valid)


def average_recall(name, estimates, poses, valid, counts, models, K, width):
    """Of MSSD or MSPD, in [0, 1].

    Args:
        name: "mssd" or "mspd".
        estimates, poses, valid, counts: as for `recall`, with R and t.
        models: object -> model with points, diameter, symmetries.
        K, width: of all images.
    """
    gap = scaled(name, estimates, poses, models, K, width)
    return np.mean([recall(gap, t, estimates, poses, valid, counts) for t in THRESHOLDS[name]])


def scaled(name, estimates, poses, models, K, width):
    """`gap(estimate, pose)` of MSSD or MSPD in the unit of the thresholds, each measured once."""
    known = {}

    def gap(k, number):
        if (k, number) not in known:
            est, pose = estimates[k], poses[number]
            model = models[est["object"]]
            value = error(name, K, (est["R"], est["t"]), (pose["R"], pose["t"]), model)
            known[k, number] = value / (model.diameter if name == "mssd" else width / 640)
        return known[k, number]

    return gap


def detection_precision(gap, thresholds, estimates, poses, counted, object_id):
    """BOP24's average precision of one object over thresholds; None if no pose of it counts.

    Args:
        gap, estimates, poses: as for `recall`.
        thresholds: a list.
        counted: for each of the poses whether it is to be found.
        object_id: which object.
    """
    images = sorted({pose["image"] for pose in poses if pose["object"] == object_id})
    total = sum(c for c, pose in zip(counted, poses, strict=True) if pose["object"] == object_id)
    if not total:
        return None
    looked_at = set()
    for image in {e["image"] for e in estimates}:
        here = [k for k, e in enumerate(estimates) if e["image"] == image]
        looked_at |= set(sorted(here, key=lambda k: -estimates[k]["score"])[:100])
    precisions = []
    for threshold in thresholds:
        kept = []  # score, and whether it is right
        for image in images:
            mine = [
                k
                for k, e in enumerate(estimates)
                if (e["image"], e["object"]) == (image, object_id) and k in looked_at
            ]
            taken = set()
            for k in sorted(mine, key=lambda k: -estimates[k]["score"]):
                best, best_error = None, threshold
                for number, pose in enumerate(poses):
                    if (pose["image"], pose["object"]) != (image, object_id):
                        continue
                    if number not in taken and gap(k, number) < best_error:
                        best, best_error = number, gap(k, number)
                if best is not None:
                    taken.add(best)
                if best is None or counted[best]:
                    kept.append((estimates[k]["score"], best is not None))
        precisions.append(coco(kept, total))
    return np.mean(precisions)


def coco(kept, total):
    """The mean over 101 recalls of the best precision there or beyond."""
    points, right = [], 0
    for rank, (_, hit) in enumerate(sorted(kept, key=lambda pair: -pair[0]), 1):
        right += hit
        points.append((right / total, right / rank))
    best = []
    for at in np.linspace(0, 1, 101):
        best.append(max((precision for found, precision in points if found >= at), default=0.0))
    return np.mean(best)
