"""Floor 2: registration, poses from matched points, unmatched points and pixels."""

from posecore.registration.alignment import Alignment, umeyama
from posecore.registration.distorted_pnp import pnp_distorted
from posecore.registration.icp import IcpResult, icp, refine_on_depth
from posecore.registration.planes import Plane, fit_plane
from posecore.registration.pnp import PnpResult, pnp
from posecore.registration.robust_alignment import RobustAlignment, ransac_umeyama
from posecore.registration.weighted_pnp import uncertainty_pnp

__all__ = [
    "Alignment",
    "IcpResult",
    "Plane",
    "PnpResult",
    "RobustAlignment",
    "fit_plane",
    "icp",
    "pnp",
    "pnp_distorted",
    "ransac_umeyama",
    "refine_on_depth",
    "umeyama",
    "uncertainty_pnp",
]
