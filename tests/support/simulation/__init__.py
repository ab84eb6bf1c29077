"""Arms, poses and scenes of known truth, and renders kept on disk."""
