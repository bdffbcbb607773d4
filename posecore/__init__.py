"""posecore: 6-DoF object pose estimation, from rotations and metrics to networks."""

__version__ = "0.1.0"

import posecore.loaded  # noqa: F401 - before all others
