"""What chapter 8 measures: Tables 1 to 4 in small, and the corners that the paper leaves out.

Networks and tests are in `field_training`, `outcomes`, `comparison` and `speed`. "add" is the
recall in % by ADD(-S), "projection" that by the 2D projection metric.
"""

from __future__ import annotations

import torch
from torch import Tensor

from book.ch08_vector_fields import comparison, speed, witness
from book.ch08_vector_fields import field_training as training
from book.tools.checkpoints import Training
from book.tools.claims import Claim
from book.tools.keys import Key
from book.tools.ledger import Measurement

HIGHER = {"better": "higher", "unit": "%"}
OURS = {"source": "not in the paper", "ours": True}

CLAIMS = [
    Claim(id="projection_easy", statement="The projection loss, as mended here, raises ADD(-S)",
          source="Table 1, average", measurement="losses",
          favoured=Key("pixel", "easy", "add"), other=Key("none", "easy", "add"),
          paper=(90.93, 86.27), **HIGHER),
    Claim(id="projection_occluded",
          statement="The projection loss, as mended here, raises ADD(-S) where things are occluded",
          source="Table 3, average", measurement="losses",
          favoured=Key("pixel", "occluded", "add"), other=Key("none", "occluded", "add"),
          paper=(41.71, 40.81), **HIGHER),
    Claim(id="projection_2d",
          statement="The projection loss, as mended here, raises the 2D projection metric",
          source="Table 2, average", measurement="losses",
          favoured=Key("pixel", "easy", "projection"), other=Key("none", "easy", "projection"),
          paper=(99.11, 99.00), **HIGHER),
    Claim(id="units_easy",
          statement="The projection loss with vectors in pixels is better than with unit vectors",
          measurement="losses",
          favoured=Key("pixel", "easy", "add"), other=Key("unit", "easy", "add"),
          **HIGHER, **OURS),
    Claim(id="units_occluded", statement="The same, occluded", measurement="losses",
          favoured=Key("pixel", "occluded", "add"), other=Key("unit", "occluded", "add"),
          **HIGHER, **OURS),
    Claim(id="forward_easy",
          statement="The projection loss is better late, without vectors that point away, than as "
          "printed",
          measurement="losses",
          favoured=Key("pixel", "easy", "add"), other=Key("printed", "easy", "add"),
          **HIGHER, **OURS),
    Claim(id="forward_occluded", statement="The same, occluded", measurement="losses",
          favoured=Key("pixel", "occluded", "add"), other=Key("printed", "occluded", "add"),
          **HIGHER, **OURS),
    Claim(id="weight_easy",
          statement="A weight that begins late and grows from 0.01 to 0.05 is better than 0.05 "
          "from the beginning",
          source="section III-B", measurement="losses",
          favoured=Key("pixel", "easy", "add"), other=Key("constant", "easy", "add"), **HIGHER),
    Claim(id="weight_occluded", statement="The same, occluded",
          source="section III-B", measurement="losses",
          favoured=Key("pixel", "occluded", "add"), other=Key("constant", "occluded", "add"),
          **HIGHER),
    Claim(id="covariance_easy",
          statement="PnP that knows how sure each keypoint is, is better than plain PnP",
          source="PVNet, section 3.2", measurement="losses",
          favoured=Key("pixel", "easy", "add"), other=Key("plain PnP", "easy", "add"), **HIGHER),
    Claim(id="covariance_occluded", statement="The same, occluded",
          source="PVNet, section 3.2", measurement="losses",
          favoured=Key("pixel", "occluded", "add"), other=Key("plain PnP", "occluded", "add"),
          **HIGHER),
    Claim(id="angles_easy",
          statement="Votes that end with least squares of angles are better than with those of "
          "lines",
          measurement="losses",
          favoured=Key("pixel", "easy", "add"), other=Key("lines", "easy", "add"),
          **HIGHER, **OURS),
    Claim(id="angles_occluded", statement="The same, occluded", measurement="losses",
          favoured=Key("pixel", "occluded", "add"), other=Key("lines", "occluded", "add"),
          **HIGHER, **OURS),
    Claim(id="refined_easy", statement="The refiner raises ADD(-S)",
          source="Table 1, average", measurement="systems",
          favoured=Key("OPEPL-R", "easy", "add"), other=Key("OPEPL", "easy", "add"),
          paper=(91.68, 90.93), **HIGHER),
    Claim(id="refined_occluded",
          statement="The refiner raises ADD(-S) where things are occluded",
          source="Table 3, average", measurement="systems",
          favoured=Key("OPEPL-R", "occluded", "add"), other=Key("OPEPL", "occluded", "add"),
          paper=(42.21, 41.71), **HIGHER),
    Claim(id="refined_2d", statement="The refiner costs a little by the 2D projection metric",
          source="Table 2, average", measurement="systems",
          favoured=Key("OPEPL", "easy", "projection"),
          other=Key("OPEPL-R", "easy", "projection"), paper=(99.11, 98.89), **HIGHER),
    Claim(id="own_easy",
          statement="A refiner should learn from the system's own poses, not only from true ones "
          "made wrong by chance",
          measurement="systems",
          favoured=Key("OPEPL-R", "easy", "add"), other=Key("by chance", "easy", "add"),
          **HIGHER, **OURS),
    Claim(id="own_occluded", statement="The same, occluded", measurement="systems",
          favoured=Key("OPEPL-R", "occluded", "add"), other=Key("by chance", "occluded", "add"),
          **HIGHER, **OURS),
    # Section IV-E says that both averages are the same, as nearly all is refined. Of the objects
    # behind them none differs by more than 0.28: so far apart the paper itself calls the same. (The
    # row was measured before it had a margin, but nothing measured went into it.)
    Claim(id="discriminative_easy",
          statement="Refining where model and mask overlap is as good as refining always",
          source="Table 1, average; section IV-E", measurement="systems",
          favoured=Key("OPEPL-DR", "easy", "add"), other=Key("OPEPL-R", "easy", "add"),
          margin=0.28, margin_source="the largest difference of one object in Table 1, the duck's",
          paper=(91.68, 91.68), unit="%"),
    Claim(id="discriminative_occluded",
          statement="Refining where model and mask overlap is better than refining always, "
          "where things are occluded",
          source="Table 3, average", measurement="systems",
          favoured=Key("OPEPL-DR", "occluded", "add"), other=Key("OPEPL-R", "occluded", "add"),
          paper=(42.33, 42.21), **HIGHER),
    Claim(id="speed", statement="Three objects take less than three times as long as one",
          source="Table 4, 20 fps against three times 24", measurement="speed",
          favoured=speed.time_key(3), other=speed.THREE_TIMES_ONE,
          paper=(1000 / 20, 3 * 1000 / 24), better="lower", unit="ms"),
]  # fmt: skip

MEASUREMENTS = {
    "losses": Measurement(comparison.compare_losses, range(3), comparison.DATA,
                          witness=witness.witness_losses),
    "systems": Measurement(comparison.compare_systems, range(3), comparison.DATA,
                           witness=witness.witness_systems),
    "speed": Measurement(speed.measure_speed, range(3), training.DATA, timed=True),
}  # fmt: skip


def train_field() -> dict[str, Tensor]:
    """The network that the page ships: longer than those that are compared, in half precision.

    With the loss that was the best of them on average; and from windows anywhere it learns what a
    bare table is, which in those of the comparison it takes for a vase now and then.
    """
    net, _ = training.train_net(training.recipe())
    return _halved(net.state_dict())


def train_refiner() -> dict[str, Tensor]:
    """The refiner for the network that the page ships."""
    net = training.new_net()
    net.load_state_dict(train_field())
    steps = training.recipe().refiner_steps
    return _halved(comparison.train_refiner(net.eval(), seed=0, steps=steps).state_dict())


CHECKPOINTS = {
    "field": Training(train_field, training.DATA),
    "refiner": Training(train_refiner, training.DATA),
}


def _halved(weights: dict[str, Tensor]) -> dict[str, Tensor]:
    """Weights of half the size. Statistics of batch normalisation stay: they may be large."""
    return {
        name: value.half() if value.dtype == torch.float32 and "running" not in name else value
        for name, value in weights.items()
    }
