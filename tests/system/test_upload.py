"""`gridpose upload` against a real service: layouts, resumption, refusals, and what it says of them."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from app.agent import ServiceClient
from app.cli.process import ServiceProcess

SmallImage = Callable[[int], bytes]


def upload(service: ServiceProcess, folder: Path, *options: str, key: str | None = None) -> tuple[int, str]:
    ended = subprocess.run(
        [sys.executable, "-m", "app.cli", "upload", str(folder), "--url", service.url, *options],
        env={**os.environ, "GRIDPOSE_KEY": key or service.admin_key or "", "COLUMNS": "200", "NO_COLOR": "1"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert "Traceback" not in ended.stderr
    return ended.returncode, ended.stdout + ended.stderr


@pytest.fixture
def folder(tmp_path: Path, small_image: SmallImage) -> Path:
    root = tmp_path / "images"
    for number, name in enumerate(("P1/1.png", "P1/2.png", "P2/1.png", "P10/front-c4.png")):
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(small_image(number))
    (root / "notes.txt").write_text("no image")
    return root


def test_a_new_session_is_made_and_a_second_run_sends_nothing(service: ServiceProcess, folder: Path) -> None:
    options = ("--session", "Cell 7", "--target", "chessboard:9x6:25")
    code, said = upload(service, folder, *options)
    assert code == 0, said
    assert "4 sent, 0 already there, 0 failed" in said
    assert "were left: 1" in said

    code, said = upload(service, folder, *options)
    assert code == 0, said
    assert "0 sent, 4 already there, 0 failed" in said
    with ServiceClient(service.url, service.admin_key) as client:
        (session,) = client.items("/v1/sessions")
        assert len(list(client.items("/v1/targets"))) == 1
        tags = {
            (m["pose_id"], m["cycle"]) for m in client.items(f"/v1/sessions/{session['id']}/measurements")
        }
    assert tags == {("P1", 1), ("P1", 2), ("P2", 1), ("P10", 4)}

    code, said = upload(service, folder, "--session", "Cell 7", "--target", "chessboard:10x7:25")
    assert code == 1
    assert "target_not_in_session" in said


def test_it_goes_on_where_it_was_interrupted(
    service: ServiceProcess, folder: Path, tmp_path: Path, small_image: SmallImage
) -> None:
    part = tmp_path / "part"
    shutil.copytree(folder / "P1", part / "P1")
    assert upload(service, part, "--session", "s", "--target", "chessboard:9x6:25")[0] == 0
    (folder / "P2" / "copy.png").write_bytes(small_image(2))  # P2/1.png once more
    code, said = upload(service, folder, "--session", "s")
    assert code == 0, said
    assert "2 sent, 3 already there, 0 failed" in said


def test_what_fails_is_listed_and_the_rest_is_sent(service: ServiceProcess, folder: Path) -> None:
    (folder / "P1" / "3.png").write_bytes(b"")
    (folder / "P1" / "4.png").write_bytes(b"GIF89a...")
    (folder / "pose one").mkdir()
    (folder / "pose one" / "5.png").write_bytes(b"x")
    code, said = upload(service, folder, "--session", "s", "--target", "chessboard:9x6:25")
    assert code == 1
    assert "4 sent, 0 already there, 3 failed" in said
    for expected in (
        "P1/3.png",
        "empty_upload",
        "P1/4.png",
        "unsupported_image",
        "pose one/5.png",
        "no pose ID",
    ):
        assert expected in said


def test_refusals_are_listed_when_it_waits(service: ServiceProcess, folder: Path, photo: Path) -> None:
    shutil.copy(photo, folder / "P1" / "9.jpg")
    code, said = upload(service, folder, "--session", "s", "--target", "chessboard:9x6:25", "--wait")
    assert code == 1
    assert "1 calibrated, 4 refused" in said
    assert "target_not_found" in said

    good = folder.parent / "good"
    good.mkdir()
    shutil.copy(photo, good / "left01.jpg")
    code, said = upload(service, good, "--session", "s", "--pose", "P9", "--wait")
    assert code == 0, said
    assert "1 calibrated, 0 refused" in said


def test_what_was_measured_by_name_is_no_refusal(
    service: ServiceProcess, photo: Path, tmp_path: Path
) -> None:
    data = photo.read_bytes()
    sha256 = hashlib.sha256(data).hexdigest()
    with ServiceClient(service.url, service.admin_key) as client:
        shown, absent = (
            client.create("/v1/targets", {"name": "t", "kind": "chessboard", "pitch_mm": 25.0, **size})["id"]
            for size in ({"columns": 9, "rows": 6}, {"columns": 5, "rows": 4})
        )
        session_id = client.create("/v1/sessions", {"name": "s", "target_ids": [shown, absent]})["id"]
        for target_id in (shown, None):
            client.put_image(session_id, "P1", sha256, data, target_id=target_id)
    folder = tmp_path / "P1"
    folder.mkdir()
    shutil.copy(photo, folder)
    code, said = upload(service, tmp_path, "--session", "s", "--wait")
    assert code == 0, said
    assert "0 sent, 1 already there, 0 failed" in said
    assert "1 calibrated, 0 refused" in said
    assert "1 measured before" in said


def test_a_wrong_key_and_a_missing_service_are_said_to_be_that(service: ServiceProcess, folder: Path) -> None:
    code, said = upload(service, folder, "--session", "s", key="gp_nobody")
    assert code == 1
    assert "not_authenticated" in said
    code, said = upload(service, folder, "--session", "s")
    assert code == 1
    assert "--target chessboard:9x6:25" in said
    service.stop()
    code, said = upload(service, folder, "--session", "s", "--retry-for", "0.5")
    assert code == 1
    assert "No answer from" in said


def test_a_folder_without_images_and_a_bad_pattern_are_refused(
    service: ServiceProcess, tmp_path: Path
) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    assert upload(service, empty, "--session", "s")[0] == 2
    code, said = upload(service, empty, "--session", "s", "--pattern", "{cycle}")
    assert code == 2
    assert "{pose}" in said
