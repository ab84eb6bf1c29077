"""A report of a session of images: made, verified, archived, restored elsewhere, and verified again."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from app.cli.main import app
from core.targets.specification import TargetSpec
from tests.support.image.images import encode
from tests.support.jobs.runners import compute
from tests.support.service.service import TARGET, Api, ApiMaker, wait_until
from tests.support.simulation.renders import render
from tests.support.simulation.scenes import standard_scene

pytestmark = (
    pytest.mark.slow
)  # images are measured three times, and processes of the analyses load the numerics
POSES, CYCLES = 2, 4
ANALYSES = ("repeatability", "intrinsics", "camera-poses")
FORMS = ("json", "html", "pdf", "csv", "xml", "sig")


def send_images(api: Api) -> str:
    """A session of a few rendered views, each seen several times by a camera with noise."""
    board = TargetSpec("chessboard", TARGET["columns"], TARGET["rows"], TARGET["pitch_mm"])
    session: str = api.make_session(conditions={"operator": "R. Meier"})
    rng = np.random.default_rng(7)
    for pose in range(1, POSES + 1):
        view = render(standard_scene(board, seed=pose, tilt=math.radians(25.0 + 5.0 * pose), clutter=0.0))
        for cycle in range(1, CYCLES + 1):
            noisy = np.clip(view + rng.normal(0.0, 2.0, view.shape), 0, 255).round().astype(np.uint8)
            assert api.put_image(session, encode(".png", noisy), f"P{pose}", cycle=cycle).status_code == 202
    compute(api)
    return session


def make_report(api: Api, session: str) -> str:
    report: str = api.client.post(f"/v1/sessions/{session}/reports", json={"kind": "repeatability"}).json()[
        "id"
    ]
    wait_until(
        lambda: document(api, report)["status"] in ("succeeded", "failed"), 300.0, "the report is made"
    )
    assert document(api, report)["status"] == "succeeded", document(api, report)["failure"]
    return report


def document(api: Api, report: str) -> dict[str, Any]:
    found: dict[str, Any] = api.client.get(f"/v1/reports/{report}").json()
    return found


def verify(api: Api, report: str) -> None:
    found = api.client.get(f"/v1/reports/{report}/verify").json()
    assert found["agrees"], found
    assert found["figures_equal"] == found["figures"] > 100
    assert found["originals"]["measured"] == found["originals"]["identical"] == POSES * CYCLES


def answers(api: Api, session: str, report: str) -> dict[str, bytes]:
    paths = [f"/v1/sessions/{session}/{analysis}" for analysis in ANALYSES]
    paths += [f"/v1/sessions/{session}/measurements", f"/v1/sessions/{session}"]
    paths += [f"/v1/reports/{report}{ending}" for ending in ("", *(f".{form}" for form in FORMS))]
    found = {}
    for path in paths:
        response = api.client.get(path)
        assert response.status_code == 200, response.text
        found[path] = response.content
    return found


def gridpose(*arguments: str | Path) -> None:
    ended = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert ended.exit_code == 0, ended.output


def test_a_report_verifies_in_another_installation(open_api: ApiMaker, tmp_path: Path) -> None:
    archive = tmp_path / "cell.tar.gz"
    with open_api() as here:
        session = send_images(here)
        report = make_report(here, session)
        verify(here, report)
        before = answers(here, session, report)
        # While the service runs.
        folder = here.installation.settings.data_dir
        gridpose("sessions", "archive", session, archive, "--data-dir", folder)
    with open_api() as there:
        assert there.client.get(f"/v1/sessions/{session}").status_code == 404
        gridpose("sessions", "restore", archive, "--data-dir", there.installation.settings.data_dir)
        assert answers(there, session, report) == before
        verify(there, report)
