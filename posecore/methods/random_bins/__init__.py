"""RandomizedBins: a pose from the picture itself, by classes whose borders are drawn at random."""
