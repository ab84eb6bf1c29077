"""Rounds of the runner, and results that are encoded where they are computed."""

from __future__ import annotations

import time
from typing import Any

import pytest
import sqlalchemy as sa

from app.jobs import pace
from app.jobs.pace import GATHER_S, Pace
from app.jobs.queue import JobResult
from app.records.outcome import Outcome
from app.records.tables import Result
from tests.support.jobs.runners import queue_images


def test_results_wait_for_others_only_where_others_may_come() -> None:
    first = Pace()
    assert first.gather_s(busy=False) == 0.0, "the first result of all waits for nobody"
    assert first.gather_s(busy=True) == GATHER_S
    first.saved()
    assert first.gather_s(busy=False) == GATHER_S


def test_who_is_called_does_not_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pace, "PACE_S", 100.0)
    calm = Pace()
    started = time.monotonic()
    calm.rest()  # nothing came before
    calm.hurry()
    calm.rest()
    assert time.monotonic() - started < 50.0
    monkeypatch.setattr(pace, "PACE_S", 0.0)
    calm.rest()  # one call, one round


def test_a_round_rests_soon_after_another(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pace, "PACE_S", 0.3)
    calm = Pace()
    # Before the first round: what passes until the second is asked for shortens its rest.
    began = time.monotonic()
    calm.rest()
    calm.rest()
    assert time.monotonic() - began >= 0.3


def test_a_round_long_after_another_does_not_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pace, "PACE_S", 100.0)
    calm = Pace()
    calm.rest()
    began, true_time = time.perf_counter(), time.monotonic
    with monkeypatch.context() as clock:
        clock.setattr(time, "monotonic", lambda: true_time() + 101.0)
        calm.rest()
    assert time.perf_counter() - began < 50.0


def test_a_result_as_text_is_stored_as_the_same_document(any_api: Any, grey_png: bytes) -> None:
    columns = {
        "estimator": "zhang",
        "calibration": {"fx_px": 1.0 / 3.0, "tiny": 5e-324, "name": "tür ß", "none": None},
        "points": b"\0\1",
        "points_warnings": [],
        "capture_quality": None,
        "content_sha256": "0" * 64,
        "core_version": "1",
        "settings": {"target": {"columns": 9}},
        "input_sha256": "1" * 64,
    }
    queue, database = any_api.installation.queue, any_api.installation.database
    plain, encoded = queue_images(any_api, grey_png, "ab")
    outcomes = {plain: Outcome(columns, None), encoded: Outcome(columns, None).encoded()}
    jobs = queue.claim(2)
    assert queue.finish([JobResult(job, outcomes[job.measurement_id], 1.0) for job in jobs]) == 2
    with database.engine.connect() as connection:
        rows = connection.execute(sa.select(Result.__table__)).mappings().all()
        text = sa.select(Result.measurement_id, sa.cast(Result.calibration, sa.Text))
        written = {row[0]: row[1] for row in connection.execute(text)}
    stored = {row["measurement_id"]: {name: row[name] for name in columns} for row in rows}
    assert stored[plain] == stored[encoded] == columns
    assert written[plain] == written[encoded]
