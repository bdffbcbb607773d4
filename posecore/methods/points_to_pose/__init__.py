"""From a cloud of points to a pose: P2R, which reads a rotation off seeds; P2P, where they vote."""
