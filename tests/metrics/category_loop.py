"""Category-level average precision in the plainest loops, one estimate at a time.

`by_the_paper` is written from Wang et al., Normalized Object Coordinate Space, CVPR 2019, section
6, and from the PASCAL VOC definition of average precision; `by_the_code` from what the evaluation
script published with it does. Estimates and objects are dicts with image, category, R, t, size; the
first have a score, the second an axis.
"""

import numpy as np

from posecore import metrics


def about(axis, angle):
    """Rodrigues' formula."""
    x, y, z = axis / np.linalg.norm(axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def corners(R, t, size):
    signs = [[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)]
    return np.array([R @ (np.array(sign) * size / 2) + t for sign in signs])


def overlap(estimate, thing):
    """The best 3D IoU over turns of the estimate, if the object has an axis."""
    sides = [x[name] for x in (estimate, thing) for name in ("R", "t", "size")]
    return float(metrics.turned_iou_3d(*sides, thing["axis"]))  # tested on its own


def legacy_overlap(estimate, thing):
    """What the script calls IoU: extremes over x, y and z of each corner."""
    best = 0.0
    for step in range(20) if np.any(thing["axis"]) else [0]:
        R = estimate["R"] @ about(np.array([0, 1, 0]), 2 * np.pi * step / 20)
        one = corners(R, estimate["t"], estimate["size"])
        two = corners(thing["R"], thing["t"], thing["size"])
        low = np.maximum(one.min(1), two.min(1))
        high = np.minimum(one.max(1), two.max(1))
        shared = 0.0 if (high - low).min() < 0 else np.prod(high - low)
        union = np.prod(np.ptp(one, axis=1)) + np.prod(np.ptp(two, axis=1)) - shared
        best = max(best, shared / union)
    return best


def errors(estimate, thing):
    """Degrees and centimetres."""
    if np.any(thing["axis"]):
        a, b = (x["R"] @ thing["axis"] / np.linalg.norm(thing["axis"]) for x in (estimate, thing))
        cosine = a @ b
    else:
        cosine = (np.trace(estimate["R"].T @ thing["R"]) - 1) / 2
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return angle, 100 * np.linalg.norm(estimate["t"] - thing["t"])


def average_precision(marks, count):
    """Of marks (right or not), the surest first: the mean of the best precision at each recall."""
    total = 0.0
    for k in range(1, count + 1):  # precision at recall k / count is the best from there on
        best = 0.0
        for n in range(1, len(marks) + 1):
            if sum(marks[:n]) >= k:
                best = max(best, sum(marks[:n]) / n)
        total += best / count
    return total


def overlaps_of(estimates, things, how):
    """{(number of estimate, number of object): overlap} of those in one image."""
    return {
        (i, j): how(e, t)
        for i, e in enumerate(estimates)
        for j, t in enumerate(things)
        if e["image"] == t["image"]
    }


def pairs_of(estimates, things, threshold, overlaps):
    """(number of estimate, number of object) of each image, the surest estimate first."""
    pairs = []
    for image in sorted({e["image"] for e in estimates}):
        mine = [i for i, e in enumerate(estimates) if e["image"] == image]
        free = [j for j, t in enumerate(things) if t["image"] == image]
        for i in sorted(mine, key=lambda i: -estimates[i]["score"]):
            values = {j: overlaps[i, j] for j in free}
            best = max(values, key=values.get, default=None)
            if best is not None and values[best] > threshold:
                pairs.append((i, best))
                free.remove(best)
    return pairs


def marks_of(estimates, right, among=None):
    order = sorted(range(len(estimates)), key=lambda i: -estimates[i]["score"])
    return [i in right for i in order if among is None or i in among]


def by_the_paper(estimates, things, ious, poses):
    """{threshold: AP}, {limits: AP of pairs}, {limits: AP of all}, of one category."""
    box, overlaps = {}, overlaps_of(estimates, things, overlap)
    for threshold in ious:
        right = {i for i, _ in pairs_of(estimates, things, threshold, overlaps)}
        box[threshold] = average_precision(marks_of(estimates, right), len(things))
    pairs, pose, of_all = pairs_of(estimates, things, 0.1, overlaps), {}, {}
    for degrees, cm in poses:
        right = set()
        for i, j in pairs:
            angle, shift = errors(estimates[i], things[j])
            if angle < degrees and shift < cm:
                right.add(i)
        among = {i for i, _ in pairs}
        pose[degrees, cm] = average_precision(marks_of(estimates, right, among), len(pairs))
        of_all[degrees, cm] = average_precision(marks_of(estimates, right), len(things))
    return box, pose, of_all


def by_the_code(estimates, things, ious, poses):
    """{threshold: AP}, {limits: AP of pairs}, of one category."""
    box, overlaps = {}, overlaps_of(estimates, things, legacy_overlap)
    for threshold in ious:
        right = {i for i, _ in pairs_of(estimates, things, threshold, overlaps)}
        box[threshold] = average_precision(marks_of(estimates, right), len(things))
    pairs, pose = pairs_of(estimates, things, 0.1, overlaps), {}
    for degrees, cm in poses:
        right, free = set(), {j for _, j in pairs}
        for i, _ in pairs:  # image after image, the surest first
            best, least = None, np.inf
            for j in free:
                if things[j]["image"] != estimates[i]["image"]:
                    continue
                angle, shift = errors(estimates[i], things[j])
                if angle <= degrees and shift <= cm and angle + shift < least:
                    best, least = j, angle + shift
            if best is not None:
                free.remove(best)
                right.add(i)
        among = {i for i, _ in pairs}
        pose[degrees, cm] = average_precision(marks_of(estimates, right, among), len(pairs))
    return box, pose
