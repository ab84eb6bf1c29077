"""Originals of images: files of this machine, or objects of S3; and their thumbnails."""

from __future__ import annotations

from pathlib import Path

from app.blobs.interface import Blobs
from app.blobs.local import LocalBlobs
from app.blobs.s3 import Guard, S3Blobs

__all__ = ["Blobs", "LocalBlobs", "S3Blobs", "open_store"]


def open_store(url: str | None, folder: Path, guard: Guard) -> Blobs:
    """Return the originals at `url`, of S3, or without one those in `folder`, which receives uploads in any case.

    `guard` excludes other processes that share the store.
    """
    return LocalBlobs(folder) if url is None else S3Blobs(url, folder, guard)
