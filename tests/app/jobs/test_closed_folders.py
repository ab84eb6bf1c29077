"""Folders of another owner: refusals that say so, jobs that wait, and a service that is not ready.

Root may read everything, so that the system's calls are replaced; none of our own code is.
"""

from __future__ import annotations

import errno
import os
import threading
from pathlib import Path
from typing import Any

import pytest

from app.blobs.integrity import read_original
from app.blobs.thumbnails import Thumbnails
from app.errors import StorageUnusable
from app.jobs.painting.worker import paint_thumbnail
from app.jobs.settlement import Settlement
from app.services.health import check_storage


class Waiting:
    """A queue that notes what it is given back."""

    def __init__(self) -> None:
        self.released: list[Any] = []

    def release(self, jobs: list[Any]) -> None:
        self.released += jobs


def refuse(*_arguments: Any, **_options: Any) -> Any:
    raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), "D/originals")


def test_an_original_that_is_closed_to_the_service_is_neither_lost_nor_a_defect(
    api: Any, grey_png: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    stored = api.put_image(api.make_session(), grey_png).json()
    path = api.installation.blobs.path(stored["sha256"])
    with monkeypatch.context() as patched:
        patched.setattr("io.open", refuse)
        answer = api.client.get(f"/v1/measurements/{stored['id']}/image")
        drawn = paint_thumbnail(str(path), stored["sha256"], 10**7)
    assert (answer.status_code, answer.json()["code"]) == (503, "storage_unavailable")
    assert answer.headers["retry-after"]
    assert "D/originals" not in answer.text
    assert getattr(drawn, "code", None) == "storage_unavailable"


def test_a_job_whose_original_is_closed_goes_back_without_an_attempt(
    api: Any, grey_png: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    stored = api.put_image(api.make_session(), grey_png).json()
    (job,) = api.installation.queue.claim(1)
    with monkeypatch.context() as patched:
        patched.setattr("io.open", refuse)
        with pytest.raises(StorageUnusable) as raised:
            read_original(api.installation.blobs.path(stored["sha256"]), stored["sha256"])
    monkeypatch.setattr("app.jobs.settlement.STORAGE_PAUSE_S", 0.0)
    queue = Waiting()
    settlement = Settlement(queue, timeout_s=1.0, stopping=threading.Event())  # type: ignore[arg-type]
    settlement.add(job, None, raised.value)
    assert settlement.settle()
    assert queue.released == [job]


def test_readiness_says_which_folder_cannot_be_used(api: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    assert all(check.ok for check in check_storage(api.installation))
    incoming = api.installation.blobs.root / "incoming"
    may = os.access
    with monkeypatch.context() as patched:
        patched.setattr(os, "access", lambda path, mode: Path(path) != incoming and may(path, mode))
        (bad,) = [check for check in check_storage(api.installation) if not check.ok]
    assert str(incoming) in bad.detail
    incoming.rmdir()
    (bad,) = [check for check in check_storage(api.installation) if not check.ok]
    assert str(incoming) in bad.detail


def test_a_thumbnail_that_can_neither_be_written_nor_removed_is_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for call in ("mkdir", "unlink", "write_bytes"):
        monkeypatch.setattr(Path, call, refuse)
    thumbnails = Thumbnails(tmp_path / "thumbnails")
    thumbnails.write("0" * 64, b"x")
    assert thumbnails.read("0" * 64) is None
