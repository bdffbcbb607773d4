"""Points that become pictures, differentiably."""

from posecore.splat.projector import Pictures, render, to_voxels

__all__ = ["Pictures", "render", "to_voxels"]
