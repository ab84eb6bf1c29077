"""Repeatability of simulated cycles: many trials of one pose, and single ones."""
