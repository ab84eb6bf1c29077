"""A robot's geometry: Denavit-Hartenberg chains, joint axes from sweeps, and their identification with uncertainty."""
