"""Camera calibration and pose from grid points."""
