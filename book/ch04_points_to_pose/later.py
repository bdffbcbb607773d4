"""What chapter 4 can measure and has not: claims that its ledger does not answer yet."""

from __future__ import annotations

from book.ch04_points_to_pose import claimed as now
from book.ch04_points_to_pose import experiments, longer
from book.ch04_points_to_pose.runs import key
from book.tools.claims import Claim
from book.tools.ledger import Measurement

__all__ = ["MEASUREMENTS", "NOT_MEASURED"]

NOT_MEASURED = [
    Claim(id="crossed",
          statement="Clouds of drivers that the cloud estimator has not seen teach better poses "
          "than those of drivers that it has seen",
          measurement="crossed", **now.pair("p2p, crossed", "p2p, seen", "MAE"), **now.OURS),
    Claim(id="size", statement="Larger glasses are easier",
          source="section 4.5; Table 3, P2P, HOLO and NORTH, MAE", measurement="sizes",
          paper=(0.46, 0.58), **now.pair("p2p, size 1.4", "p2p, size 0.7", "MAE")),
    Claim(id="size_bmae", statement="The same in extreme poses",
          source="section 4.3.1; Table 3, P2P, BMAE", measurement="sizes",
          paper=(0.72, 1.68), **now.pair("p2p, size 1.4", "p2p, size 0.7", "BMAE")),
    Claim(id="size_position", statement="P2P's position hardly depends on the glasses",
          source="section 4.4; Table 4, HOLO and NORTH", measurement="sizes", paper=(5.35, 6.15),
          favoured=key("p2p, size 1.4", "position"), other=key("p2p, size 0.7", "position"),
          margin=2.0, unit="mm", margin_source="a fifth of an error of 10 mm, stated before it was "
          "measured; the paper's range is a fifth of its mean"),
    Claim(id="size_x", statement="CloudPose's error along x is larger for smaller glasses",
          source="section 4.4; Table 4, HOLO and NORTH", measurement="sizes", paper=(7.87, 11.20),
          **now.pair("cloudpose, size 1.4", "cloudpose, size 0.7", "position x")),
    Claim(id="p2r_places", statement="P2R that is told where its seeds are errs less",
          measurement="places", **now.pair("p2r, places", "p2r", "MAE"), **now.OURS),
    Claim(id="p2p_places", statement="P2P that is told where its seeds are errs less",
          measurement="places", **now.pair("p2p, places", "p2p", "MAE"), **now.OURS),
    Claim(id="p2r_flat", statement="P2R has learned what it can: 4000 steps are as good as 2000",
          measurement="longer_p2r", favoured=key("p2r longer, book", "MAE"),
          other=key("p2r, book", "MAE"), **now.FLAT),
    Claim(id="bins_flat",
          statement="RandomizedBins has learned what it can: 4000 steps are as good",
          measurement="longer_bins", favoured=key("bins longer, book", "MAE"),
          other=key("bins, book", "MAE"), **now.FLAT),
]  # fmt: skip

MEASUREMENTS = {
    "sizes": Measurement(experiments.measure_sizes, range(3), experiments.BOTH),
    "crossed": Measurement(experiments.measure_crossed, range(3), experiments.BOTH),
    "places": Measurement(experiments.measure_places, range(3), experiments.BOTH),
    "longer_p2r": Measurement(longer.measure_p2r, range(3), experiments.BOTH),
    "longer_bins": Measurement(longer.measure_bins, range(3), experiments.BOTH),
}
"""To be moved into `experiments.MEASUREMENTS`, with their claims, when they are measured."""
