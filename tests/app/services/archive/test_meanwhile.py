"""Archives that are made and restored while others change the same installation."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from app.errors import ArchiveRefused, NotFound
from app.records.file_lock import FileLock
from app.services.archive import archive_session, making, restore_session
from app.services.archive.container import ArchiveWriter
from app.services.installation.context import ServiceContext
from app.services.sessions import delete_session
from tests.support.service.service import Api


def test_a_session_that_is_deleted_while_it_is_archived_is_said_to_be_gone(
    archive: Path, session_id: str, other: ServiceContext, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    restore_session(other, archive)

    def deleted_first(*given: Any) -> ArchiveWriter:
        delete_session(other.database, other.blobs, session_id)
        return ArchiveWriter(*given)

    monkeypatch.setattr(making, "ArchiveWriter", deleted_first)
    with pytest.raises(NotFound) as caught:
        archive_session(other, session_id, tmp_path / "late.tar.gz")
    assert caught.value.code == "session_not_found"
    assert not list(tmp_path.glob("*late*"))


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
        assert made.wait(120.0)
        outcomes = [_outcome(partial(restore_session, other, archive)), _outcome(first.result)]
    assert sorted(outcomes) == ["restored", "session_present"]


def _outcome(restore: Callable[[], object]) -> str:
    try:
        restore()
    except ArchiveRefused as error:
        return error.code
    return "restored"


@pytest.mark.skipif(os.name != "posix", reason="elsewhere an open file is removed by nobody")
def test_what_a_killed_archive_left_goes_with_the_next_and_what_is_being_written_stays(
    source: Api, session_id: str, tmp_path: Path
) -> None:
    left = tmp_path / ".cell [7].tar.gz.123456.partial"
    another = tmp_path / ".cell [8].tar.gz.123456.partial"
    in_use = tmp_path / ".cell [7].tar.gz.123457.partial"
    for path in (left, another, in_use):
        path.write_bytes(b"half")
    with FileLock(in_use):
        archive_session(source.installation, session_id, tmp_path / "cell [7].tar.gz")
    assert not left.exists()
    assert another.exists()
    assert in_use.exists()


def test_an_archive_being_written_is_left_alone_by_another_to_the_same_file(
    source: Api, session_id: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = making._Archive.write

    def archived_twice(archive: Any, file: Any) -> Any:
        monkeypatch.setattr(making._Archive, "write", begun)
        monkeypatch.setattr(os, "getpid", lambda: 999_999)
        archive_session(source.installation, session_id, tmp_path / "cell.tar.gz")
        return begun(archive, file)

    monkeypatch.setattr(making._Archive, "write", archived_twice)
    archive_session(source.installation, session_id, tmp_path / "cell.tar.gz")
    assert [path.name for path in tmp_path.iterdir()] == ["cell.tar.gz"]
