"""From a cloud of points to a pose: P2R and P2P."""
