"""`gridpose hand-eye export` and `camera-poses export`: results as files for other programs."""
