"""Plots of a camera over its image: residuals, projection uncertainty, and what lens models leave over."""
