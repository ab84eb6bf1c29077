"""Analyses: what the stored measurements of a session amount to, computed from their points; no image is opened."""
