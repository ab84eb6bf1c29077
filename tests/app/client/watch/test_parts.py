"""The parts of watching: whole files, standing still, metadata, and the journal."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import sqlite3
from pathlib import Path

import cv2
import numpy as np
import pytest

from app.client.images.files import legal_pose_id
from app.client.watch import Journal, JournalInUse, JournalUnusable
from app.client.watch.files.intact import why_incomplete
from app.client.watch.files.metadata import MetadataError, read_sidecar, read_table, sidecar_of
from app.client.watch.files.scan import Found, Settling, in_natural_order, list_folder, signature_of
from app.client.watch.journal import Entry
from app.client.watch.report import Report
from app.client.watch.results import _move
from tests.support.image.images import encode

PIXELS = np.random.default_rng(3).integers(0, 256, (40, 60, 3), dtype=np.uint8)
FORMATS = {
    "png": encode(".png", PIXELS),
    "jpg": encode(".jpg", PIXELS),
    "progressive": encode(".jpg", PIXELS, cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
    "tiff": encode(".tiff", PIXELS),
    "bmp": encode(".bmp", PIXELS),
}


@pytest.mark.parametrize("kind", FORMATS)
def test_a_file_is_whole_with_its_last_byte_and_not_before(kind: str) -> None:
    data = FORMATS[kind]
    assert why_incomplete(data) is None
    for end in (0, 1, 7, 12, 40, len(data) // 2, len(data) - 3):
        # The strip of a TIFF lies before its directory, whose last bytes are values that may be unused.
        assert why_incomplete(data[:end]) is not None, end


def test_the_end_of_an_embedded_thumbnail_is_not_the_end_of_the_image() -> None:
    thumbnail = b"Exif\0\0" + FORMATS["jpg"][:900] + b"\xff\xd9"
    segment = b"\xff\xe1" + (len(thumbnail) + 2).to_bytes(2, "big") + thumbnail
    data = FORMATS["jpg"][:2] + segment + FORMATS["jpg"][2:]
    assert why_incomplete(data) is None
    assert why_incomplete(data[: len(segment) + 300]) is not None


def test_what_is_of_no_known_format_is_for_the_service_to_judge() -> None:
    assert why_incomplete(b"no image at all") is None


def test_a_file_stands_still_after_two_looks_and_its_time() -> None:
    now = [0.0]
    settling = Settling(2.0, lambda: now[0])
    first = Found("a.png", "a.png", "10:1:1")
    assert list(settling.still([first])) == []
    now[0] = 1.9
    assert list(settling.still([first])) == []
    grown = Found("a.png", "a.png", "20:2:1")
    now[0] = 2.5
    assert list(settling.still([grown])) == []
    now[0] = 4.6
    assert list(settling.still([grown])) == [grown]
    assert list(settling.still([])) == []
    assert list(settling.still([grown])) == [], "it was away meanwhile"


def test_a_listing_has_images_at_any_depth_and_no_others(tmp_path: Path) -> None:
    for name in ("P10/1.png", "P2/1.PNG", "P2/notes.txt", ".hidden/1.png", "P2/.1.png", "sent/P1/1.png"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")
    (tmp_path / "again").symlink_to(tmp_path, target_is_directory=True)
    (tmp_path / "again.png").symlink_to(tmp_path, target_is_directory=True)
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "P2" / "pipe.png")
    listing = list_folder(tmp_path, excluded=tmp_path / "sent")
    assert [found.name for found in in_natural_order(listing.images)] == ["P2/1.PNG", "P10/1.png"]
    assert list_folder(tmp_path / "nowhere").unreadable == {".": "No such file or directory"}


def test_names_people_give_become_pose_ids() -> None:
    assert legal_pose_id("Größe 1") == ("Groesse-1", True)
    assert legal_pose_id("P 1 (links)") == ("P-1-links", True)
    assert legal_pose_id("Café_2.b") == ("Cafe_2.b", True)
    assert legal_pose_id("P1") == ("P1", False)
    assert legal_pose_id("測定") == ("測定", False)


def test_sidecars_and_tables_give_angles_poses_and_times(tmp_path: Path) -> None:
    image = tmp_path / "1.png"
    (tmp_path / "1.json").write_text(
        json.dumps({"cycle": 3, "joint_angles_deg": [1, -2.5], "approach": "home"})
    )
    found = sidecar_of(image)
    assert found is not None
    metadata = read_sidecar(found)
    assert (metadata.cycle, metadata.joint_angles_deg, metadata.command) == (
        3,
        (1.0, -2.5),
        {"approach": "home"},
    )
    table = tmp_path / "poses.csv"
    table.write_text(
        "file;pose_id;x_mm;y_mm;z_mm;j1_deg\nP1\\1.png;P1;;;;10,5\n;P2;1;2;3,5;\n;P3;1;2;;\n;P4;1;2;3"
    )
    rows = read_table(table)
    assert rows.of("P1/1.png").joint_angles_deg == (10.5,)  # type: ignore[union-attr]
    assert rows.commands == {"P2": {"position_mm": [1.0, 2.0, 3.5]}}, "the last line has not ended"
    assert rows.errors == ["poses.csv, line 4: a coordinate is missing; fill x_mm, y_mm and z_mm, or none"]


LONGEST = "a" * 251 + ".png"


def test_an_image_whose_name_leaves_no_room_for_a_sidecars_has_none(tmp_path: Path) -> None:
    """It was never sent: `File name too long`."""
    image = tmp_path / LONGEST
    image.touch()
    assert sidecar_of(image) is None
    (tmp_path / "1.csv").touch()
    assert sidecar_of(tmp_path / "1.png") == tmp_path / "1.csv"


def test_a_file_with_the_longest_name_is_moved_to_another_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    image = tmp_path / LONGEST
    image.write_bytes(b"x")
    digest = hashlib.sha256(b"x").hexdigest()
    entry = Entry(LONGEST, signature_of(image.stat()), "P1", None, digest, "measured", "mea_1")

    def on_another_disk(*_arguments: object) -> None:
        raise OSError(errno.EXDEV, "Invalid cross-device link")

    monkeypatch.setattr(Path, "rename", on_another_disk)
    _move(image, tmp_path / "moved" / LONGEST, entry)
    assert [path.name for path in (tmp_path / "moved").iterdir()] == [LONGEST]
    assert not image.exists()


@pytest.mark.parametrize(
    "text",
    ['{"cycle": 0}', '{"joint_angles_deg": "1"}', "[1]", '{"speed": 1}', '{"cycle": 1', '{"roll_deg": NaN}'],
)
def test_a_sidecar_that_cannot_be_used_says_why(text: str, tmp_path: Path) -> None:
    path = tmp_path / "1.json"
    path.write_text(text)
    with pytest.raises(MetadataError, match=r"1\.json"):
        read_sidecar(path)


ENTRY = Entry("P1/1.png", "10:1:1", "P1", 4, "ab" * 32, "stored", "mea_1")


def test_the_journal_keeps_what_became_of_a_file(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "journal.sqlite")
    with pytest.raises(JournalInUse):
        Journal(tmp_path / "journal.sqlite")
    journal.record("s1", ENTRY)
    journal.record_pose("s1", "P1", "{}")
    journal.record_session("cell", "s1", None)
    journal.close()
    journal = Journal(tmp_path / "journal.sqlite")
    assert journal.entries("s1") == {"P1/1.png": ENTRY}
    assert journal.entries("s2") == {}
    assert journal.find_image("s1", "P1", "ab" * 32) == ENTRY
    assert journal.find_image("s1", "P2", "ab" * 32) is None
    assert (journal.last_cycle("s1", "P1"), journal.last_cycle("s1", "P2")) == (4, 0)
    assert (journal.pose("s1", "P1"), journal.session("cell")) == ("{}", ("s1", None))
    journal.advance("s1", Entry("P1/1.png", "older", "P1", 4, "ab" * 32, "stored"), "done", None)
    assert journal.in_state("s1", "stored") == [ENTRY], "the file was replaced meanwhile"
    journal.advance("s1", ENTRY, "measured", None)
    assert [entry.state for entry in journal.in_state("s1", "measured", "failed")] == ["measured"]
    journal.forget("s1", ["P1/1.png"])
    assert journal.entries("s1") == {}
    journal.close()


def test_a_damaged_journal_is_kept_and_replaced(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    path.write_bytes(b"no database, and longer than its header would be" * 100)
    journal = Journal(path)
    assert journal.replaced is not None
    assert journal.replaced.read_bytes().startswith(b"no database")
    assert journal.entries("s1") == {}
    journal.close()


def test_a_journal_without_room_says_so(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "journal.sqlite")
    journal._connection.execute("PRAGMA max_page_count = 1")
    many = [Entry(f"{number}.png", "10:1:1", "P1", None, "ab" * 32, "stored") for number in range(200)]
    with pytest.raises(JournalUnusable, match="full"):
        list(map(journal.record, ["s1"] * len(many), many))
    journal.close()
    with pytest.raises(JournalUnusable):
        Journal(Path("/proc/nowhere/journal.sqlite"))


def test_a_journal_that_only_just_began_is_read(tmp_path: Path) -> None:
    sqlite3.connect(tmp_path / "journal.sqlite").close()
    Journal(tmp_path / "journal.sqlite").close()


def test_each_trouble_is_reported_once_and_many_are_counted(tmp_path: Path) -> None:
    lines: list[str] = []
    report = Report(lines.append, tmp_path / "state.json", {"session": "cell"})
    for number in range(9):
        report.trouble("refused", f"{number}.png", "it is text")
        report.trouble("refused", f"{number}.png", "it is text")
    assert len(lines) == 6
    report.over("refused", "0.png")
    report.over("refused", "0.png", "not said again")
    report.tick(3, last=True)
    assert lines[-1] == "0 stored, 3 waiting, refused: 8"
    state = json.loads((tmp_path / "state.json").read_text())
    assert (state["session"], state["waiting"], state["trouble_count"], state["running"]) == (
        "cell",
        3,
        8,
        False,
    )
