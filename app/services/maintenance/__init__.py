"""Periodic work of a running service: removing originals, orphans, and sessions past their retention."""
