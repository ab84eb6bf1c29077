"""What `gridpose upload` says before and after."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from app.client import FilePlan, ImageFile, SessionResult, UploadResult
from app.client.commands.images.intention import show_intention
from app.client.commands.images.outcome import report
from app.client.commands.images.transfer import Transferred

CAMERA = {"intrinsics": {"fx_px": 1000.0}, "standard_uncertainty": {"fx_px": 4.0}}
FLAT, LOST = "focal_not_observable", "target_not_found"


def measured(place: int, pose_id: str, code: str | None) -> dict[str, Any]:
    return {
        "id": f"mea_{place}",
        "excluded": None,
        "pose_id": pose_id,
        "sha256": str(place),
        "cycle": None,
        "status": "failed" if code else "succeeded",
        "calibration": None if code else {"grade": "determined"},
        "failure": {"code": code, "detail": "It is so.", "advice": "Do this."} if code else None,
    }


def said(
    codes: list[tuple[str, str | None]],
    cameras: list[dict[str, Any]] | None,
    *others: dict[str, Any],
    excluded: Sequence[dict[str, Any]] = (),
) -> tuple[str, int]:
    """The report on images of these poses and failures, and the exit code; `others` are further measurements."""
    files = [ImageFile(Path(f"{i}.png"), f"{i}.png", pose, None) for i, (pose, _) in enumerate(codes)]
    results = [UploadResult(file, "sent", str(i)) for i, file in enumerate(files)]
    found = [measured(i, pose, code) for i, (pose, code) in enumerate(codes)]
    console = Console(width=400, record=True, file=io.StringIO())
    transferred = Transferred("ses_1", results, SessionResult((*found, *others)), cameras, list(excluded))
    code = report(console, FilePlan(tuple(files), (), 0), transferred)
    return console.export_text(), code


def test_an_image_is_measured_or_not_and_never_both() -> None:
    text, code = said([(f"P{i}", FLAT) for i in range(5)], None)
    assert "5 photographs measured, which do not determine the camera yet" in text
    assert "refused" not in text.lower()
    assert "not measured" not in text.lower()
    assert "the camera is not determined yet" in text
    assert "Do this." in text
    assert code == 1


def test_what_serves_the_session_camera_is_not_listed() -> None:
    text, code = said([("P1", FLAT), ("P2", None), ("P3", LOST)], [CAMERA])
    assert "2 photographs measured; 1 determines the camera by itself" in text
    assert "1 photograph not measured" in text
    assert "0.png" not in text
    assert "2.png" in text
    assert code == 1
    assert said([("P1", FLAT), ("P2", None)], [CAMERA])[1] == 0


def test_what_is_in_no_camera_of_the_session_is_listed_with_its_reason() -> None:
    other = {"measurement_id": "mea_1", "code": "image_size_differs", "detail": "It has 480 x 640 px."}
    text, code = said([("P1", None), ("P2", None)], [CAMERA], excluded=[other])
    assert "2 photographs measured" in text
    assert "not in the session's camera" in text
    assert "1.png" in text
    assert "It has 480 x 640 px. (image_size_differs)" in text
    assert "--focus-group" in text
    assert "0.png" not in text
    assert code == 1


def test_an_image_measured_under_another_target_is_not_listed() -> None:
    text, code = said([("P1", None)], [CAMERA], measured(0, "P1", LOST))
    assert "1 photograph measured" in text
    assert "not measured" not in text
    assert code == 0


@pytest.mark.parametrize(
    ("poses", "words"),
    [
        (["P1", "P2", "P3"], "next: `gridpose sessions export-camera`"),
        (["P1", "P1", "P2"], "1 of 2 poses has two measured images or more, as repeatability needs"),
    ],
)
def test_repeatability_is_spoken_of_where_poses_repeat(poses: list[str], words: str) -> None:
    text, _ = said([(pose, None) for pose in poses], [CAMERA])
    assert words in text
    assert ("0 of" in text) is False


@pytest.mark.parametrize(
    ("poses", "words"),
    [(["P1"], "1 pose × 1 cycle = 1 image,"), (["P1", "P2", "P2"], "2 poses × 1 to 2 cycles = 3 images,")],
)
def test_one_is_singular(tmp_path: Path, poses: list[str], words: str) -> None:
    images = []
    for place, pose in enumerate(poses):
        path = tmp_path / f"{place}.png"
        path.write_bytes(b"x")
        images.append(ImageFile(path, path.name, pose, None))
    console = Console(width=400, record=True, file=io.StringIO())
    show_intention(console, images, FilePlan(tuple(images), (), 0), "S", None, 1)
    text = console.export_text()
    assert words in text
    assert "1 image has no cycle in its name and is numbered" in text
