"""`gridpose targets` against a real service: what is stored there is printed, what was measured there is checked."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from app.cli.demo.service_process import ServiceProcess
from app.client import ServiceClient
from tests.support.command_line import gridpose_here


def test_a_stored_target_is_printed_and_its_session_checked(
    tmp_path: Path, data_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    photos = tmp_path / "photos"
    photos.mkdir()
    for photo in (data_folder / "opencv_samples").glob("left[01]*.jpg"):
        shutil.copy(photo, photos)
    with ServiceProcess(tmp_path / "data", {"GRIDPOSE_WORKERS": "1"}) as service:

        def gridpose(*arguments: str) -> subprocess.CompletedProcess[str]:
            return gridpose_here(*arguments, GRIDPOSE_URL=service.url, GRIDPOSE_KEY=service.admin_key or "")

        gridpose(
            "upload",
            "photos",
            "--session",
            "cell",
            "--target",
            "chessboard:9x6:25",
            "--pattern",
            "{pose}",
            "--wait",
        )
        checked = gridpose("targets", "check", "--session", "cell", "--ruler", "x:200:200.1", "--json")
        report = json.loads(checked.stdout)
        assert report["photos"] == 13
        assert (report["target"]["kind"], report["target"]["pitch_mm"]) == ("chessboard", 25.0)
        aspect = next(finding for finding in report["findings"] if finding["code"] == "aspect")
        # The same photographs, looked at by the command itself, say the same.
        described = ("--kind", "chessboard", "--columns", "9", "--rows", "6", "--pitch-mm", "25")
        names = sorted(str(path) for path in photos.iterdir())
        here = json.loads(gridpose("targets", "check", *names, *described, "--json").stdout)
        again = next(finding for finding in here["findings"] if finding["code"] == "aspect")
        assert again["value"] == pytest.approx(aspect["value"], abs=0.1 * aspect["standard_uncertainty"])
        with ServiceClient(service.url, service.admin_key) as client:
            (target,) = client.items("/v1/targets")
        printed = gridpose("targets", "print", "--target-id", target["id"], "-o", "board.pdf")
        assert printed.returncode == 0
        assert target["name"] in printed.stderr
        assert (tmp_path / "board.pdf").read_bytes().startswith(b"%PDF-")
        for refused in (
            gridpose("targets", "check", "--session", "nosuch"),
            gridpose("robots", "export", "--session", "nosuch", "--format", "urdf"),
            gridpose("targets", "print", "--target-id", "tgt_nosuch"),
        ):
            assert (refused.returncode, refused.stdout) == (1, "")
            assert refused.stderr
            assert "--target " not in refused.stderr  # an option of `upload`, not of these
