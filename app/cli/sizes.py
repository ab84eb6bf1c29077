"""Sizes as the commands print them."""

from __future__ import annotations


def megabytes(count: int) -> str:
    """Return a number of bytes in MB, as all sizes of originals and files are printed."""
    return f"{count / 1e6:.1f} MB"
