"""Analyses of a session, computed from the stored grid points; no image is opened."""
