"""Several restores at once, in one data folder."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pytest

from app.errors import ArchiveRefused
from app.records.file_lock import FileLock
from app.services.archive import restore_session
from app.services.installation.context import ServiceContext


def test_restores_that_begin_at_once_leave_each_other_their_folders(
    archive: Path, other: ServiceContext, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken, made = FileLock.acquire, threading.Event()

    def slowly(lock: FileLock, *, wait: bool = False) -> None:
        if not wait and not made.is_set():  # the first folder is there, its lock is not taken yet
            made.set()
            time.sleep(0.3)
        taken(lock, wait=wait)

    monkeypatch.setattr(FileLock, "acquire", slowly)
    with ThreadPoolExecutor(1) as elsewhere:
        first = elsewhere.submit(restore_session, other, archive)
        assert made.wait(30.0)
        outcomes = [_outcome(partial(restore_session, other, archive)), _outcome(first.result)]
    assert sorted(outcomes) == ["restored", "session_present"]


def _outcome(restore: Callable[[], object]) -> str:
    try:
        restore()
    except ArchiveRefused as error:
        return error.code
    return "restored"
