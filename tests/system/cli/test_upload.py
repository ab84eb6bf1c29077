"""`gridpose upload` against a real service: layouts, resumption, refusals, and what it says of them."""

from __future__ import annotations

import hashlib
import re
import shutil
import socket
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from app.cli.demo.service_process import ServiceProcess
from app.client import ServiceClient
from tests.support.command_line import gridpose_here
from tests.support.image.images import small_image
from tests.support.service.service import gridpose

Command = Callable[..., subprocess.CompletedProcess[str]]


def upload(
    service: ServiceProcess,
    folder: Path,
    *options: str,
    key: str | None = None,
    run: Command = gridpose_here,
) -> tuple[int, str]:
    ended = run(
        "upload", str(folder), "--url", service.url, *options, GRIDPOSE_KEY=key or service.admin_key or ""
    )
    return ended.returncode, ended.stdout + ended.stderr


def tally(said: str, *words: str) -> tuple[int, ...]:
    """Return the numbers that stand before these words."""
    found = {word: int(number) for number, word in re.findall(r"(\d+) (\w+)", said)}
    return tuple(found[word] for word in words)


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    """One service for all tests here, each with a session of its own."""
    with ServiceProcess(tmp_path_factory.mktemp("upload") / "data", {"GRIDPOSE_WORKERS": "1"}) as process:
        yield process


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    root = tmp_path / "images"
    for number, name in enumerate(("P1/1.png", "P1/2.png", "P2/1.png", "P10/front-c4.png")):
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(small_image(number))
    (root / "notes.txt").write_text("no image")
    return root


def test_a_new_session_is_made_and_a_second_run_sends_nothing(service: ServiceProcess, folder: Path) -> None:
    options = ("--session", "Cell 7", "--target", "chessboard:9x6:25")
    code, said = upload(service, folder, *options, run=gridpose)
    assert code == 0, said
    assert tally(said, "sent", "already", "failed") == (4, 0, 0)

    code, said = upload(service, folder, *options, run=gridpose)
    assert code == 0, said
    assert tally(said, "sent", "already", "failed") == (0, 4, 0)
    with ServiceClient(service.url, service.admin_key) as client:
        (session,) = (one for one in client.items("/v1/sessions") if one["name"] == "Cell 7")
        assert len(session["target_ids"]) == 1
        measurements = list(client.items(f"/v1/sessions/{session['id']}/measurements"))
    assert said.splitlines()[0] == session["id"], "the last line of stdout, here before stderr"
    assert {(m["pose_id"], m["cycle"], m["filename"]) for m in measurements} == {
        ("P1", 1, "1.png"),
        ("P1", 2, "2.png"),
        ("P2", 1, "1.png"),
        ("P10", 4, "front-c4.png"),
    }

    code, said = upload(service, folder, "--session", "Cell 7", "--target", "chessboard:10x7:25")
    assert code == 1
    assert "target_not_in_session" in said


def test_it_goes_on_where_it_was_interrupted(service: ServiceProcess, folder: Path, tmp_path: Path) -> None:
    part = tmp_path / "part"
    shutil.copytree(folder / "P1", part / "P1")
    assert upload(service, part, "--session", "interrupted", "--target", "chessboard:9x6:25")[0] == 0
    (folder / "P2" / "copy.png").write_bytes(small_image(2))  # P2/1.png once more
    code, said = upload(service, folder, "--session", "interrupted")
    assert code == 0, said
    assert tally(said, "sent", "already", "failed") == (2, 3, 0)


def test_what_fails_is_listed_and_the_rest_is_sent(service: ServiceProcess, folder: Path) -> None:
    (folder / "P1" / "3.png").write_bytes(b"")
    (folder / "P1" / "4.png").write_bytes(b"GIF89a...")
    (folder / "pose one").mkdir()
    (folder / "pose one" / "5.png").write_bytes(b"x")
    code, said = upload(service, folder, "--session", "failing", "--target", "chessboard:9x6:25")
    assert code == 1
    assert tally(said, "sent", "already", "failed") == (4, 0, 3)
    for expected in (
        "P1/3.png",
        "empty_upload",
        "P1/4.png",
        "unsupported_image",
        "pose one/5.png",
    ):
        assert expected in said


def test_refusals_are_listed_when_it_waits(service: ServiceProcess, folder: Path, photo: Path) -> None:
    shutil.copy(photo, folder / "P1" / "9.jpg")
    code, said = upload(service, folder, "--session", "unclear", "--target", "chessboard:9x6:25", "--wait")
    assert code == 1
    assert tally(said, "photograph", "photographs") == (1, 4)
    assert "target_not_found" in said

    good = folder.parent / "good"
    good.mkdir()
    shutil.copy(photo, good / "left01.jpg")
    code, said = upload(service, good, "--session", "unclear", "--pose", "P9", "--wait")
    assert code == 0, said
    assert tally(said, "photograph") == (1,)
    assert "not measured" not in said


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
        session_id = client.create("/v1/sessions", {"name": "by name", "target_ids": [shown, absent]})["id"]
        for target_id in (shown, None):
            client.put_image(session_id, "P1", sha256, data, target_id=target_id)
    folder = tmp_path / "P1"
    folder.mkdir()
    shutil.copy(photo, folder)
    code, said = upload(service, tmp_path, "--session", "by name", "--wait")
    assert code == 0, said
    assert tally(said, "sent", "already", "failed") == (0, 1, 0)
    assert tally(said, "photograph") == (1,)
    assert "refused" not in said
    assert "1 already measured" in said


def test_a_wrong_key_and_a_missing_service_are_identified(service: ServiceProcess, folder: Path) -> None:
    code, said = upload(service, folder, "--session", "nobody", key="gp_nobody")
    assert code == 1
    assert "not_authenticated" in said
    code, said = upload(service, folder, "--session", "nobody")
    assert code == 1
    assert "--target" in said
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))  # nothing listens there, and nothing else can meanwhile
        url = f"http://127.0.0.1:{silent.getsockname()[1]}"
        code, said = upload(service, folder, "--session", "nobody", "--retry-timeout", "0.5", "--url", url)
    assert code == 1
    assert url in said


def test_a_folder_without_images_and_a_bad_pattern_are_refused(
    service: ServiceProcess, tmp_path: Path
) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    assert upload(service, empty, "--session", "empty")[0] == 2
    code, said = upload(service, empty, "--session", "empty", "--pattern", "{cycle}")
    assert code == 2
    assert "{pose}" in said


@pytest.mark.parametrize("more", [(), ("--dry-run",)])
def test_a_pattern_that_no_name_has_sends_nothing_and_names_the_reason(
    service: ServiceProcess, folder: Path, more: tuple[str, ...]
) -> None:
    options = ("--session", "Cell 11", "--target", "chessboard:9x6:25", "--pattern", "stop{pose}_{cycle}")
    code, said = upload(service, folder, *options, *more)
    assert code == 2
    assert "None of the 4 images" in said
    assert "P1/1.png" in said
    assert "Traceback" not in said
    with ServiceClient(service.url, service.admin_key) as client:
        assert not [one for one in client.items("/v1/sessions") if one["name"] == "Cell 11"]


def test_it_says_first_what_it_will_do_and_leaves_nothing_behind(
    service: ServiceProcess, tmp_path: Path
) -> None:
    root = tmp_path / "images"
    for number, name in enumerate(("Größe 1/b.png", "Größe 1/a.png", "Größe 1/c.png", "P2/1.png")):
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(small_image(100 + number))
    target = "charuco:9x6:25,marker=18,dictionary=DICT_5X5_100"
    options = ("--session", "Cell 9", "--target", target)
    code, said = upload(service, root, *options, "--dry-run")
    assert code == 0
    assert "2 poses × 1 to 3 cycles = 4 images" in said
    assert "pose 'Größe 1' becomes Groesse-1" in said
    assert "3 images have no cycle" in said
    with ServiceClient(service.url, service.admin_key) as client:
        assert not [one for one in client.items("/v1/sessions") if one["name"] == "Cell 9"]
        code, said = upload(service, root, *options)
        assert code == 0, said
        (session,) = (one for one in client.items("/v1/sessions") if one["name"] == "Cell 9")
        (board,) = (client.get(f"/v1/targets/{one}") for one in session["target_ids"])
        assert (board["marker_mm"], board["dictionary"]) == (18.0, "DICT_5X5_100")
        path = f"/v1/sessions/{session['id']}/measurements"
        cycles = {m["filename"]: (m["pose_id"], m["cycle"]) for m in client.items(path)}
        assert cycles["b.png"] == ("Groesse-1", 2)
        (root / "Größe 1" / "aa.png").write_bytes(small_image(110))
        assert upload(service, root, "--session", "Cell 9", "--target", target)[0] == 0
        cycles = {m["filename"]: (m["pose_id"], m["cycle"]) for m in client.items(path)}
        assert cycles["aa.png"] == ("Groesse-1", 4), "after those that are there"

        bad = tmp_path / "bad"
        bad.mkdir()
        for number in range(12):
            (bad / f"P{number}.png").write_bytes(b"text %d" % number)
        code, said = upload(service, bad, "--session", "nothing", "--target", "chessboard:9x6:25")
        assert code == 1
        assert "12 failed" in said
        assert "and 4 more" in " ".join(said.split()), "one reason is listed once"
        assert not [one for one in client.items("/v1/sessions") if one["name"] == "nothing"]


@pytest.mark.parametrize(
    ("target", "code", "advice"),
    [
        ("charuco:9x6,edge=3", 2, "charuco:9x6:25,marker=18"),  # the option cannot be used; nothing was sent
        ("board of the day", 1, "gridpose targets list"),
    ],
)
def test_a_target_that_cannot_be_read_shows_the_right_form(
    service: ServiceProcess, folder: Path, target: str, code: int, advice: str
) -> None:
    ended, said = upload(service, folder, "--session", "Cell 10", "--target", target)
    assert ended == code
    assert advice in " ".join(said.split())
