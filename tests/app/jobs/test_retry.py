"""A retry keeps the result there is until another one replaces it."""

from __future__ import annotations

from typing import Any

import pytest

from app.jobs.queue import JobResult
from app.jobs.settlement import WORKER_CRASHED
from app.records.codec import encode_refused
from app.records.outcome import Failure, Outcome, Provenance
from tests.support.jobs.runners import compute
from tests.support.sessions.stored_sessions import new_session, shoot, store_shots

NOTHING = encode_refused(None, Provenance("0.1.0", "0" * 64, {}))
NOT_FOUND = Outcome(NOTHING, Failure("target_not_found", "Nothing there.", None))
TIMED_OUT = Outcome(None, Failure("processing_timeout", "It took too long.", "Retry."))
SAME = ("calibration", "capture_quality", "labelling", "failure", "finished_at", "duration_ms")


def fetch(api: Any, measurement_id: str) -> dict[str, Any]:
    document: dict[str, Any] = api.client.get(
        f"/v1/measurements/{measurement_id}", params={"include": "points"}
    ).json()
    return document


def counts(api: Any, session_id: str) -> dict[str, int]:
    found: dict[str, int] = api.client.get(f"/v1/sessions/{session_id}").json()["counts"]
    return {status: number for status, number in found.items() if number}


def retry(api: Any, measurement_id: str) -> None:
    assert api.client.post(f"/v1/measurements/{measurement_id}/retry").status_code == 202


def test_a_result_stays_until_another_replaces_it(any_api: Any, board_png: bytes) -> None:
    """It was dropped when the retry was asked for, so that a stopped service left nothing of a good measurement."""
    api, queue = any_api, any_api.installation.queue
    session_id = api.make_session()
    measurement_id = api.put_image(session_id, board_png).json()["id"]
    compute(api)
    good = fetch(api, measurement_id)
    assert good["status"] == "succeeded"

    retry(api, measurement_id)
    assert counts(api, session_id) == {"queued": 1}
    for status in ("queued", "running"):
        if status == "running":
            (job,) = queue.claim(1)
        document = fetch(api, measurement_id)
        assert (document["status"], document["attempts"]) == (status, 0)
        assert {name: document[name] for name in (*SAME, "points")} == {
            name: good[name] for name in (*SAME, "points")
        }
    assert queue.finish([JobResult(job, NOT_FOUND, 5.0)]) == 1
    replaced = fetch(api, measurement_id)
    assert (replaced["status"], replaced["failure"]["code"]) == ("failed", "target_not_found")
    assert (replaced["calibration"], replaced["points"], replaced["duration_ms"]) == (None, None, 5.0)
    assert counts(api, session_id) == {"failed": 1}


@pytest.mark.parametrize("end", ["timeout", "crash"])
def test_a_retry_that_computes_nothing_leaves_the_result(any_api: Any, board_png: bytes, end: str) -> None:
    api, queue = any_api, any_api.installation.queue
    session_id = api.make_session()
    measurement_id = api.put_image(session_id, board_png).json()["id"]
    compute(api)
    good = fetch(api, measurement_id)
    retry(api, measurement_id)
    for _ in range(1 if end == "timeout" else 3):
        (job,) = queue.claim(1)
        if end == "timeout":
            assert queue.finish([JobResult(job, TIMED_OUT, 60_000.0)]) == 1
        else:
            queue.attempt_failed(job, WORKER_CRASHED, max_attempts=3)
    kept = fetch(api, measurement_id)
    code = "processing_timeout" if end == "timeout" else "worker_crashed"
    assert kept["retry_failure"]["code"] == code
    assert kept["retry_failure"]["advice"]
    assert {**kept, "retry_failure": None, "attempts": 1} == good
    assert counts(api, session_id) == {"succeeded": 1}
    assert queue.finish([JobResult(job, NOT_FOUND, 1.0)]) == 0
    retry(api, measurement_id)
    assert fetch(api, measurement_id)["retry_failure"] is None


def test_a_failure_without_points_gives_way_to_a_later_one(any_api: Any, grey_png: bytes) -> None:
    api, queue = any_api, any_api.installation.queue
    measurement_id = api.put_image(api.make_session(), grey_png).json()["id"]
    for outcome in (NOT_FOUND, TIMED_OUT, NOT_FOUND):
        (job,) = queue.claim(1)
        assert queue.finish([JobResult(job, outcome, 1.0)]) == 1
        document = fetch(api, measurement_id)
        assert (document["failure"]["code"], document["retry_failure"]) == (outcome.failure.code, None)
        retry(api, measurement_id)


@pytest.mark.slow
def test_analyses_use_the_earlier_result_and_count_it_as_pending(api: Any) -> None:
    session_id = new_session(api)
    ids = store_shots(api, session_id, shoot(cycles=3))
    address = f"/v1/sessions/{session_id}/intrinsics"
    before = api.client.get(address)
    assert before.status_code == 200, before.text
    for measurement_id in ids:
        retry(api, measurement_id)
    during = api.client.get(address, headers={"If-None-Match": before.headers["etag"]})
    assert during.status_code == 200, during.text
    assert {**during.json(), "pending": 0} == before.json()
    assert during.json()["pending"] == len(ids)
    (job, *_) = api.installation.queue.claim(len(ids))
    api.installation.queue.finish([JobResult(job, TIMED_OUT, 1.0)])
    after = api.client.get(address).json()
    assert (after["pending"], after["inputs_sha256"]) == (len(ids) - 1, before.json()["inputs_sha256"])
