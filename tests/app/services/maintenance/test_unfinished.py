"""What a kill left half written goes after a round, and what is being written stays."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from app.blobs.durable import write_durably
from app.records.file_lock import FileLock
from app.services.maintenance.unfinished import RESTORING_LOCK, RESTORING_SESSION, UnfinishedFiles

DIGITS = "0123456789abcdef"
SHA256 = "ab" * 32


def names(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def test_files_left_by_a_kill_go_with_the_second_round(tmp_path: Path) -> None:
    (tmp_path / "originals" / "ab").mkdir(parents=True)
    kept = {
        "key-pepper",
        "installation.json",
        f"originals/ab/{SHA256}",
        "notes.0123456789ABCDEF",
        f"x.{DIGITS}0",
    }
    left = {f"key-pepper.{DIGITS}", f"installation.json.{DIGITS}", f"originals/ab/{SHA256}.{DIGITS}"}
    for name in kept | left:
        (tmp_path / name).write_bytes(b"half")
    sweep = UnfinishedFiles(tmp_path)
    assert sweep.run() == 0
    assert left <= names(tmp_path)
    being_written = f"retention.json.{DIGITS}"
    (tmp_path / being_written).write_bytes(b"half")
    assert sweep.run() == len(left)
    assert names(tmp_path) == {*kept, being_written, "migrate.lock"}
    assert UnfinishedFiles(tmp_path).run() == 0
    assert being_written in names(tmp_path)


def test_a_small_file_is_written_under_a_name_that_the_sweep_finds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sweep = UnfinishedFiles(tmp_path)

    class Killed(BaseException):
        pass

    def killed(_descriptor: int) -> None:
        raise Killed

    monkeypatch.setattr(os, "fsync", killed)
    with pytest.raises(Killed):
        write_durably(tmp_path / "key-pepper", b"secret")
    monkeypatch.undo()
    (left,) = tmp_path.iterdir()
    assert (sweep.run(), sweep.run()) == (0, 1)
    assert not left.exists()


def test_the_folder_of_a_killed_restore_goes_and_that_of_a_running_one_stays(tmp_path: Path) -> None:
    left, in_use = (tmp_path / f"{RESTORING_SESSION}{name}" for name in ("left", "in-use"))
    for folder in (left, in_use):
        folder.mkdir()
        (folder / SHA256).write_bytes(b"an original")
    with FileLock(in_use / RESTORING_LOCK):
        UnfinishedFiles(tmp_path).run()
    assert not left.exists()
    assert (in_use / SHA256).exists()
