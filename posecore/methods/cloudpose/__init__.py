"""CloudPose: two PointNets, one for the rotation and one for the translation."""
