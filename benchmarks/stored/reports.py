"""Reports and histories: drawing the forms of a 5 × 30 session, verifying its originals, a robot's 1,000 sessions."""

from __future__ import annotations

import base64
import json
import re
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from statistics import median

from starlette.testclient import TestClient

from app.analyses.history import summarise_reports
from app.analyses.reporting import VerificationOrder
from app.analyses.reporting.verification import verify_report
from app.jobs.process_image import process_image
from app.jobs.queue import JobResult
from app.main import create_app
from app.reports.forms import CompanyTemplate, render_forms
from app.settings import Settings
from benchmarks.conditions import one_core, seconds
from benchmarks.rendered_sessions import noisy, scene_of
from benchmarks.table import Row
from core.simulation import render_levels
from tests.support.image.images import encode
from tests.support.service.originals import original_path
from tests.support.service.service import Api, wait_until
from tests.support.sessions.filed_reports import content, store_filed
from tests.support.simulation.scenes import standard_target

POSES, CYCLES = 5, 30
MAX_PIXELS = 10**8
JOINT = {"a_mm": 0.0, "alpha_deg": 90.0, "d_mm": 400.0, "theta_offset_deg": 0.0}
_DRAWING = re.compile(r'src="data:image/svg\+xml;base64,([^"]+)"')
_NAMES = ("scatter", "drift", "steadiness")


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    """Yield the times of one session's report, of its verification, and of a long history."""
    with _service() as api:
        yield from _reported(api, seeds[0], 3 if quick else CYCLES, 3 if quick else 5)
    with _service() as api:
        yield from _history(api, 100 if quick else 1000)


@contextmanager
def _service() -> Iterator[Api]:
    with tempfile.TemporaryDirectory(prefix="gridpose-bench-") as folder:
        app = create_app(Settings(data_dir=Path(folder), workers=0, disk_floor_bytes=0))
        with TestClient(app, base_url="http://localhost") as client:
            api = Api(client, app.state.service)
            client.headers.update(api.key("admin"))
            yield api


def _reported(api: Api, seed: int, cycles: int, repeats: int) -> Iterable[Row]:
    """Send rendered images of one session, measure them, make its report, draw its forms, and verify it."""
    board = standard_target(9, 6)
    target = api.make_target(columns=9, rows=6, pitch_mm=board.pitch_mm)
    session = api.make_session(target)
    for pose in range(POSES):
        scene = scene_of("session", board, seed, pose)
        levels = render_levels(scene)
        for cycle in range(cycles):
            image = encode(".png", noisy(levels, scene.noise_levels, seed, pose, cycle))
            assert api.put_image(session, image, f"P{pose + 1}", cycle=cycle + 1).status_code == 202
    case = f"{POSES} poses x {cycles} cycles, rendered"
    with one_core():
        computed = _compute(api)
        report = _made(api, session)
        document = json.loads(api.client.get(f"{report}.json").content)
        page = api.client.get(f"{report}.html").text
        drawn = [base64.b64decode(one).decode() for one in _DRAWING.findall(page)]
        drawings = {
            name: [svg] for name, svg in zip(_NAMES, drawn, strict=False)
        }  # a short session lacks some
        template = CompanyTemplate()
        times = [seconds(lambda: render_forms(document, drawings, template)) for _ in range(repeats)]
        note = f"PDF, HTML, JSON, CSV and XML from stored values; {case}; median of {repeats}"
        yield Row.at_most("forms of a report, PDF among them", median(times), 1.0, "s", note)
        settings = api.installation.settings
        order = VerificationOrder(
            report_id=document["report_id"],
            with_originals=True,
            blob_url=None,
            folder=str(settings.data_dir / "originals"),
            max_image_pixels=MAX_PIXELS,
        )
        database = api.installation.database
        verify_report(
            database, replace(order, with_originals=False)
        )  # the numerics are loaded, as in the service
        started = time.process_time()
        found = verify_report(database, order)
        took = time.process_time() - started
    assert found["agrees"], found
    note = f"{POSES * cycles} images, {case}; {computed:.2f} s and {took:.2f} s of processor time"
    yield Row.at_most("verification of a report ÷ computation of its images", took / computed, 1.3, note=note)


def _compute(api: Api) -> float:
    """Measure all queued images as a worker does; return the processor time of that without the queue, s."""
    queue = api.installation.queue
    took = 0.0
    while jobs := queue.claim(50):
        finished = []
        for job in jobs:
            path = str(original_path(api.installation, job.sha256))
            started = time.process_time()
            outcome = process_image(job, path, MAX_PIXELS)
            took += time.process_time() - started
            finished.append(JobResult(job, *outcome))
        queue.finish(finished)
    return took


def _made(api: Api, session: str) -> str:
    body = {"kind": "repeatability"}
    report = f"/v1/reports/{api.client.post(f'/v1/sessions/{session}/reports', json=body).json()['id']}"
    done = ("succeeded", "failed")
    wait_until(lambda: api.client.get(report).json()["status"] in done, 300.0, "the report is made")
    found = api.client.get(report).json()
    assert found["status"] == "succeeded", found["failure"]
    return report


def _history(api: Api, sessions: int) -> Iterable[Row]:
    """Ask for the history of a robot over many filed reports."""
    robot = {"name": "r", "joints": [JOINT] * 6}
    robot_id = api.client.post("/v1/robots", json=robot).json()["id"]
    numbers = range(1000, 1000 + sessions)
    store_filed(api, [content(k, robot=robot_id, poses=5, rp_mm=0.05 + 0.001 * (k % 7)) for k in numbers])
    while summarise_reports(api.installation.database):
        pass
    with one_core():
        times = []
        for _ in range(7):
            started = time.process_time()
            response = api.client.get(f"/v1/robots/{robot_id}/history")
            times.append(time.process_time() - started)
    assert response.json()["sessions"] == sessions
    note = f"{sessions} sessions of 5 poses, client and service in one process; processor time, median of {len(times)}"
    yield Row.at_most("history of a robot over 1,000 sessions", 1e3 * median(times), 200.0, "ms", note)
