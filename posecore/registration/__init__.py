"""Floor 2: registration, poses from matched points, unmatched points and pixels."""

from posecore.registration.alignment import Alignment, umeyama
from posecore.registration.distorted_pnp import pnp_distorted
from posecore.registration.icp import IcpResult, icp, refine_on_depth
from posecore.registration.pnp import PnpResult, pnp
from posecore.registration.weighted_pnp import uncertainty_pnp

__all__ = [
    "Alignment",
    "IcpResult",
    "PnpResult",
    "icp",
    "pnp",
    "pnp_distorted",
    "refine_on_depth",
    "umeyama",
    "uncertainty_pnp",
]
