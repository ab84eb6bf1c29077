"""Limits of time hold whatever the wall clock does, and ids stay in order."""

from __future__ import annotations

import sys
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from app.jobs.subprocess_executor import Limits, SubprocessExecutor, TimedOut
from app.jobs.worker_init import start_drawing
from app.records import ids
from app.reports.forms.head import measuring_days
from app.services.installation.context import ServiceContext
from tests.support.jobs.runners import queue_images, runner_of
from tests.support.service.service import wait_until
from tests.support.sessions.stored_sessions import BOARD, board_fields, shoot, store_shots

if sys.platform == "win32":
    pytest.skip("limits of processes and /proc", allow_module_level=True)

HOUR_S = timedelta(hours=1).total_seconds()


def marker_of(api: Any, measurement_id: str) -> Path:
    sha256 = api.measurement(measurement_id)["sha256"]
    path: Path = api.installation.blobs.path(sha256)
    return path.with_name(path.name + ".mark")


@pytest.mark.slow
def test_a_wall_clock_set_forward_ends_no_job(
    api: Any, grey_png: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    (queued,) = queue_images(api, grey_png, "W")
    with runner_of(api):
        wait_until(lambda: api.measurement(queued)["status"] == "running")
        now = time.time
        monkeypatch.setattr(time, "time", lambda: now() + HOUR_S)
        stepped = time.monotonic()
        wait_until(lambda: time.monotonic() > stepped + 0.5)
        marker_of(api, queued).touch()
        ended = api.wait_for(queued)
    assert (ended["failure"]["code"], ended["attempts"]) == ("target_not_found", 1)


@pytest.mark.slow
def test_a_wall_clock_set_back_lets_no_job_run_on(
    api: Any, grey_png: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    (queued,) = queue_images(api, grey_png, "H")
    with runner_of(api, timeout_s=2.0):
        wait_until(lambda: api.measurement(queued)["status"] == "running")
        now = time.time
        monkeypatch.setattr(time, "time", lambda: now() - HOUR_S)
        ended = api.wait_for(queued)
    assert (ended["failure"]["code"], ended["attempts"]) == ("processing_timeout", 2)


@pytest.mark.slow
def test_a_job_over_its_time_is_repeated_once(api: Any, grey_png: bytes) -> None:
    (queued,) = queue_images(api, grey_png, "O")
    with runner_of(api, timeout_s=2.0) as runner:
        ended = api.wait_for(queued)
        wait_until(lambda: runner.settlement.timeouts == 1)
    assert (ended["failure"]["code"], ended["attempts"]) == ("target_not_found", 2)


def wait_for(path: str) -> str:
    """A call that ends when `path` exists."""
    while not Path(path).exists():
        time.sleep(0.01)
    return path


@pytest.mark.slow
def test_a_side_process_measures_its_time_by_no_wall_clock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clock steps an hour while a call runs; its limit holds in either direction."""
    process = SubprocessExecutor(1_000_000, Limits(time_s=5.0), start_drawing)
    try:
        process.call(max, 2, 3)
        started = time.time()
        monkeypatch.setattr(time, "time", lambda: started + HOUR_S * (time.monotonic_ns() // 10**8 % 2))
        with pytest.raises(TimedOut):
            process.call(wait_for, str(tmp_path / "never"))
        assert process.call(max, 2, 3) == 3
        (tmp_path / "there").touch()
        assert process.call(wait_for, str(tmp_path / "there"))
    finally:
        process.close()


def test_ids_are_in_order_after_the_clock_was_set_back(any_api: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a new process finds it: the queue and the pages of lists go by ids."""
    earlier = any_api.make_target()
    now_ns = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: now_ns() - 86_400 * 10**9)
    monkeypatch.setattr(ids, "_last", 0)
    ServiceContext.open(any_api.installation.settings).close()
    later = any_api.make_target()
    assert later > earlier
    listed = [each["id"] for each in any_api.client.get("/v1/targets").json()["items"]]
    assert listed == [earlier, later]


@pytest.mark.slow  # a process of the analyses loads the numerics
def test_reports_are_dated_by_the_clock_although_ids_lie_ahead(
    api: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Once the clock was ahead, ids go on from there for as long as it takes the clock to catch up."""
    monkeypatch.setattr(ids, "_last", 0)  # other tests' ids stay in time
    ids.follow([ids.least_id("rep", datetime.now(UTC) + timedelta(days=365))])
    target_id = api.make_target(**board_fields(BOARD))
    session_id = api.make_session(target_id)
    store_shots(api, session_id, shoot(poses=2, cycles=6), target_id)
    address = f"/v1/sessions/{session_id}/reports"
    report_id = api.client.post(address, json={"kind": "repeatability"}).json()["id"]

    def read() -> dict[str, Any]:
        document: dict[str, Any] = api.client.get(f"/v1/reports/{report_id}").json()
        return document

    wait_until(lambda: read()["status"] in ("succeeded", "failed"), 300.0, "the report is made")
    assert read()["status"] == "succeeded"
    content = api.client.get(f"/v1/reports/{report_id}.json").json()
    tomorrow = datetime.now(UTC) + timedelta(days=1)
    for stated in (read()["finished_at"], content["made_at"]):
        assert datetime.fromisoformat(stated) < tomorrow
    assert max(measuring_days(content)) <= tomorrow.date()
