"""Sessions with originals, and which of them the disk and the database hold."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from app.blobs import LocalBlobs
from app.records.tables import Measurement, Removal
from app.services.installation.context import ServiceContext
from app.services.maintenance.orphans import OrphanSweep
from app.services.originals import record_removals


def originals(api: Any) -> set[str]:
    return {path.name for path in api.installation.blobs.root.glob("??/*")}


def original_path(installation: ServiceContext, sha256: str) -> Path:
    """Return the file of an original that is kept on this machine."""
    blobs = installation.blobs
    assert isinstance(blobs, LocalBlobs)
    return blobs.path(sha256)


def recorded(api: Any) -> set[str]:
    with api.installation.database.read() as records:
        return set(records.scalars(sa.select(Removal.sha256)))


def fill(api: Any, grey_png: bytes, count: int = 3) -> tuple[str, set[str]]:
    """Return a session with images of its own, and their hashes."""
    session_id = api.make_session()
    images = [grey_png + b"%d" % number for number in range(count)]
    for data in images:
        assert api.put_image(session_id, data).status_code == 202
    return session_id, {hashlib.sha256(data).hexdigest() for data in images}


def new_sweep(api: Any) -> OrphanSweep:
    installation = api.installation
    return OrphanSweep(installation.database, installation.blobs, installation.settings.data_dir)


def forget(api: Any, session_id: str) -> None:
    """Delete a session as far as a process comes that is killed before it removes files."""
    with api.installation.database.write() as records:
        record_removals(records, Measurement.session_id == session_id)
        records.execute(sa.text("DELETE FROM sessions WHERE id = :id"), {"id": session_id})


@contextlib.contextmanager
def open_elsewhere(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let the system refuse to remove files, as Windows does for open ones; none of our own code is replaced."""

    def refuse(*_arguments: Any, **_options: Any) -> None:
        raise PermissionError(errno.EACCES, "the file is open")

    with monkeypatch.context() as patched:
        patched.setattr(os, "unlink", refuse)
        yield
