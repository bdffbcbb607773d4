"""What chapter 3 measures: clouds learned from masks, what each part gives, masks, and light.

"overlap" is the intersection over union, in %, of silhouette and true mask in the two views that
the network was not given; "surface" the distance in mm from the surface that is seen to the cloud,
with the cloud where it truly is; "translation" the median distance of predicted and true place.
"""

from __future__ import annotations

from torch import Tensor

from book.ch03_infrared_to_clouds import cloud_training as training
from book.ch03_infrared_to_clouds import light, threshold_masks
from book.ch03_infrared_to_clouds.cloud_training import CROWD
from book.tools.checkpoints import Training
from book.tools.claims import Claim
from book.tools.keys import Key
from book.tools.ledger import Measurement
from posecore.scale import choose

__all__ = [
    "CHECKPOINTS",
    "CLAIMS",
    "MEASUREMENTS",
    "RUNS",
    "key",
    "train_clouds",
]

RUNS = {
    "three views": {},
    "two views": {"views": 2},
    "one view": {"views": 1},
    "no intensity": {"weights": (0.2, 0.2, 0.0)},
    "no scale": {"use_scale": False},
    "scale up to 1": {"max_scale": 1.0},
    "weights of the text": {"weights": (0.4, 0.4, 0.2)},
    "absolute points": {"relative": False, "cube": 0.8},
    "sharp masks": {"mask_blur": (0.0, 0.0)},
    "sharp volume": {"blur": (training.SHARP, training.SHARP)},
    "160 pixels": {"image": (160, 94), "blocks": 6},
    "256 points": {"points": 256},
    "threshold masks": {"masks": "threshold"},
    "twelve drivers": {"split": "train"},
}
"""What tells the networks that are compared from the first of them."""
LOWER, HIGHER = {"better": "lower"}, {"better": "higher", "unit": "%"}
OURS = {"source": "not in the paper", "ours": True}


def key(run: str, metric: str) -> Key:
    """What a run is measured by."""
    return Key(run, "test", metric)


def _pair(favoured: str, other: str, metric: str) -> dict:
    side = HIGHER if metric == "overlap" else {**LOWER, "unit": "mm"}
    return {"favoured": key(favoured, metric), "other": key(other, metric), **side}


def _lost(group: str) -> dict:
    sides = (threshold_masks.in_cuboid(name, "overlap lost", group) for name in ("Li", "fixed"))
    return {**dict(zip(("favoured", "other"), sides, strict=True)), **LOWER, "unit": "%"}


CLAIMS = [
    Claim(id="learned_shape",
          statement="A cloud learned from masks covers the views that were not shown better than a "
          "head that looks straight ahead, put at the true place",
          source="section 3.1", measurement="views",
          **_pair("three views", "head straight ahead", "overlap")),
    Claim(id="learned_turn", statement="The same, of a head at the true pose",
          source="section 3.1", measurement="views",
          **_pair("three views", "head at the true pose", "overlap")),
    Claim(id="three_one", statement="Three views teach a better shape than one",
          source="section 3.1.4", measurement="views",
          **_pair("three views", "one view", "surface")),
    Claim(id="three_two", statement="Three views teach a better shape than two",
          source="section 3.1.4", measurement="views",
          **_pair("three views", "two views", "surface")),
    Claim(id="cuboid", statement="The cuboid of the pose filters background",
          source="section 3.1.1", measurement="masks",
          favoured=Key("Li", "in the cuboid", "overlap"),
          other=Key("Li", "whole image", "overlap"), **HIGHER),
    Claim(id="li_otsu", statement="Li's threshold separates better than Otsu's",
          measurement="masks", favoured=Key("Li", "in the cuboid", "overlap"),
          other=Key("Otsu", "in the cuboid", "overlap"), **HIGHER, **OURS),
    Claim(id="li_fixed", statement="Li's threshold separates better than the best fixed one",
          measurement="masks", favoured=Key("Li", "in the cuboid", "overlap"),
          other=Key("fixed", "in the cuboid", "overlap"), **HIGHER, **OURS),
    Claim(id="li_distance",
          statement="From near to far, Li's threshold loses less than the best fixed one",
          measurement="gains", **_lost("farthest third"), **OURS),
    Claim(id="li_darker",
          statement="In images half as bright, Li's threshold loses less than the best fixed one",
          measurement="gains", **_lost("gain 0.5"), **OURS),
    Claim(id="li_brighter",
          statement="In images twice as bright, Li's threshold loses less than the best fixed one",
          measurement="gains", **_lost("gain 2"), **OURS),
    Claim(id="night", statement="By night, clouds from infrared are better than from visible light",
          source="section 1", measurement="light",
          favoured=light.key("infrared", "overlap", 0), other=light.key("visible", "overlap", 0),
          **HIGHER),
    Claim(id="light", statement="Infrared depends less on light than visible light does",
          source="sections 1 and 2.2", measurement="light",
          favoured=light.key("infrared", "overlap spread"),
          other=light.key("visible", "overlap spread"), better="lower", unit="%"),
    Claim(id="intensity_shape", statement="Intensity is crucial for the quality of the cloud",
          source="section 3.1.2", measurement="parts",
          **_pair("three views", "no intensity", "surface")),
    Claim(id="scale_shape", statement="The predicted scale is crucial for it",
          source="section 3.1.2", measurement="parts",
          **_pair("three views", "no scale", "surface")),
    Claim(id="scale_range",
          statement="Where points are few, a scale of up to 4 is better than one of up to 1",
          measurement="parts", **_pair("three views", "scale up to 1", "overlap"), **OURS),
    Claim(id="exact_masks", statement="Exact masks teach a better shape than Li's",
          measurement="labels", **_pair("three views", "threshold masks", "overlap"), **OURS),
    Claim(id="drivers",
          statement="Of as many images, those of 750 drivers teach the place of a new one better "
          "than those of twelve",
          measurement="labels", **_pair("three views", "twelve drivers", "translation"), **OURS),
    Claim(id="weights", statement="Weights as printed are better than as the text explains them",
          source="Eq 3", measurement="weights",
          **_pair("three views", "weights of the text", "overlap")),
    Claim(id="relative", statement="Points relative to a place are better than absolute ones",
          source="section 3.1.2", measurement="places",
          **_pair("three views", "absolute points", "overlap")),
    Claim(id="mask_blur", statement="Masks whose blur grows are better than sharp ones",
          source="section 3.1.2", measurement="blurs",
          **_pair("three views", "sharp masks", "overlap")),
    Claim(id="volume_blur",
          statement="A volume whose blur shrinks, as in the renderer that is adapted, is better "
          "than a sharp one",
          measurement="blurs", **_pair("three views", "sharp volume", "overlap"), **OURS),
    Claim(id="pixels", statement="Images twice as wide teach a better shape",
          measurement="sizes", **_pair("160 pixels", "three views", "surface"), **OURS),
    Claim(id="points", statement="512 points are a better shape than 256",
          measurement="sizes", **_pair("three views", "256 points", "surface"), **OURS),
]  # fmt: skip


def measure_run(name: str, seed: int) -> dict[Key, float]:
    """Train one of `RUNS`, and measure it on the drivers of the test split."""
    changes = dict(RUNS[name])
    split = changes.pop("split", CROWD)
    recipe = training.compared(**changes)
    net, _ = training.train_net(recipe, split=split, seed=seed, name=name)
    measured = training.evaluate(net, recipe, most=choose(tiny=4, book=200, paper=200))
    return {
        key(name, "overlap"): 100 * float(measured.unseen().mean()),
        key(name, "overlap at the true place"): 100
        * float(measured.unseen(measured.at_truth).mean()),
        key(name, "translation"): 1000 * float(measured.off.median()),
        key(name, "surface"): 1000 * float(measured.to_cloud.nanmean()),
        key(name, "front"): 1000 * float(measured.to_surface.nanmean()),
        **{
            Key(name, camera, "overlap"): 100 * float(measured.unseen()[:, j].mean())
            for j, camera in enumerate(("left", "centre", "right"))
        },
    }


def _measure(names: tuple[str, ...], seed: int) -> dict[Key, float]:
    values: dict[Key, float] = {}
    for name in names:
        values |= measure_run(name, seed)
    return values


def measure_views(seed: int) -> dict[Key, float]:
    """Networks trained with losses in three, two and one views, and what knows no image."""
    values = _measure(("three views", "two views", "one view"), seed)
    for name, overlaps in training.floors(seed).items():
        values[key(name, "overlap")] = 100 * float(overlaps.mean())
    return values


def measure_parts(seed: int) -> dict[Key, float]:
    """Without intensities, without the predicted scale, and with one of at most 1."""
    return _measure(("three views", "no intensity", "no scale", "scale up to 1"), seed)


def measure_labels(seed: int) -> dict[Key, float]:
    """With the paper's masks, and with as many images of fewer drivers."""
    return _measure(("three views", "threshold masks", "twelve drivers"), seed)


def measure_weights(seed: int) -> dict[Key, float]:
    """With the weights that the text suggests."""
    return _measure(("three views", "weights of the text"), seed)


def measure_places(seed: int) -> dict[Key, float]:
    """With points that are not relative to a predicted place."""
    return _measure(("three views", "absolute points"), seed)


def measure_blurs(seed: int) -> dict[Key, float]:
    """Without the masks' blur, and without the volume's."""
    return _measure(("three views", "sharp masks", "sharp volume"), seed)


def measure_sizes(seed: int) -> dict[Key, float]:
    """With larger images, and with fewer points."""
    return _measure(("three views", "160 pixels", "256 points"), seed)


TRAINED = (f"headset/{CROWD}", "headset/test")
MEASUREMENTS = {
    "masks": Measurement(threshold_masks.measure, range(3), TRAINED),
    "gains": Measurement(threshold_masks.measure_gains, range(3), TRAINED),
    "light": Measurement(light.measure, range(3), TRAINED),
    "views": Measurement(measure_views, range(3), TRAINED),
    "parts": Measurement(measure_parts, range(3), TRAINED),
    "labels": Measurement(measure_labels, range(3), (*TRAINED, "headset/train")),
    "weights": Measurement(measure_weights, range(3), TRAINED),
    "places": Measurement(measure_places, range(3), TRAINED),
    "blurs": Measurement(measure_blurs, range(3), TRAINED),
    "sizes": Measurement(measure_sizes, range(3), TRAINED),
}


def train_clouds() -> dict[str, Tensor]:
    """The network that the page ships, in half precision but for what metres depend on."""
    net, _ = training.train_net(training.recipe())
    exact = {"mean", "std", "low", "high"}
    return {
        name: value if name in exact else value.half() for name, value in net.state_dict().items()
    }


CHECKPOINTS = {"clouds": Training(train_clouds, (f"headset/{CROWD}",))}
