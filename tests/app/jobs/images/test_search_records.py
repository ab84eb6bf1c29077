"""What a search writes, whatever happens to the session, its targets and its measurements meanwhile."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa

from app.jobs.queue import JobResult
from app.jobs.queue.sql_queue import SqlQueue
from app.jobs.settlement import WORKER_CRASHED
from app.records.outcome import Failure
from tests.support.jobs.searches import NOTHING, seek, shown


def test_what_was_measured_already_is_not_counted_as_failed(any_api: Any, grey_png: bytes) -> None:
    queue = any_api.installation.queue
    session_id, targets, _ = seek(any_api, grey_png)
    any_api.put_image(session_id, grey_png, target_id=targets[0])
    other, _, _ = seek(any_api, grey_png)
    searched, vain, named = queue.claim(3)  # the sessions in turn
    for job, outcome in (
        (named, dataclasses.replace(shown(named), failure=None)),
        (searched, shown(searched, 0)),
        (vain, shown(vain)),
    ):
        assert queue.finish([JobResult(job, outcome, 1.0)]) == 1

    def counts(session: str) -> dict[str, int]:
        return dict(any_api.client.get(f"/v1/sessions/{session}").json()["counts"])

    nothing = {"queued": 0, "running": 0, "succeeded": 0, "failed": 0, "duplicates": 0}
    assert counts(session_id) == {**nothing, "succeeded": 1, "duplicates": 1}
    assert counts(other) == {**nothing, "failed": 1}
    pages = any_api.client.get("/v1/sessions").json()["items"]
    assert {item["id"]: item["counts"] for item in pages} == {id_: counts(id_) for id_ in (session_id, other)}
    metrics = any_api.client.get("/metrics").text
    for status, number in (("succeeded", 1), ("failed", 1), ("duplicates", 1), ("queued", 0)):
        assert f'gridpose_measurements{{status="{status}"}} {number}.0' in metrics
    # The row itself is found among those that failed, with its code and what to do about it.
    (row,) = any_api.client.get(f"/v1/sessions/{session_id}/measurements?status=failed").json()["items"]
    assert row["failure"]["code"] == "target_already_measured"


def test_what_is_shown_is_written_once(any_api: Any, grey_png: bytes) -> None:
    queue = SqlQueue(any_api.installation.database)
    session_id, targets, measurement_id = seek(any_api, grey_png)
    (stale,) = queue.claim(1)
    assert [sought.target_id for sought in stale.targets] == targets
    assert (stale.target_id, stale.has_explicit_target) == (None, False)
    queue.recover()
    (job,) = queue.claim(1)
    assert queue.finish([JobResult(stale, shown(stale, 0, 1), 100.0)]) == 0
    assert len(any_api.measurements(session_id)) == 1
    finished = JobResult(job, shown(job, 1, 2), 100.0)
    assert queue.finish([finished, finished]) == 1
    both = any_api.measurements(session_id)
    assert [(m["target_id"], m["status"], m["attempts"]) for m in both] == [
        (targets[1], "succeeded", 1),
        (targets[2], "succeeded", 1),
    ]
    assert [m["duration_ms"] for m in both] == [88.0, 12.0]
    assert both[0]["id"] == measurement_id
    assert both[0]["finished_at"] == both[1]["finished_at"]
    assert queue.claim(9) == ()


def test_what_came_by_name_meanwhile_is_left_alone(any_api: Any, grey_png: bytes) -> None:
    queue = any_api.installation.queue
    session_id, targets, _ = seek(any_api, grey_png)
    (job,) = queue.claim(1)
    by_name = any_api.put_image(session_id, grey_png, target_id=targets[0]).json()
    assert queue.finish([JobResult(job, shown(job, 0, 1), 100.0)]) == 1
    first, other = any_api.measurements(session_id)
    assert (first["target_id"], first["status"], first["duration_ms"]) == (targets[1], "succeeded", 100.0)
    assert (other["id"], other["status"]) == (by_name["id"], "queued")
    (named,) = queue.claim(9)
    assert named.has_explicit_target
    assert [sought.target_id for sought in named.targets] == targets[:1]


def test_a_search_for_other_targets_than_the_sessions_is_handed_out_anew(
    any_api: Any, grey_png: bytes
) -> None:
    queue = any_api.installation.queue
    session_id, (kept, gone), measurement_id = seek(any_api, grey_png, targets=2)
    (stale,) = queue.claim(1)
    address = f"/v1/sessions/{session_id}"
    assert any_api.client.patch(address, json={"target_ids": [kept]}).status_code == 200
    assert queue.finish([JobResult(stale, shown(stale, 0, 1), 100.0)]) == 0
    (job,) = queue.claim(1)
    assert [sought.target_id for sought in job.targets] == [kept]
    assert queue.finish([JobResult(job, shown(job, 0), 100.0)]) == 1
    (row,) = any_api.measurements(session_id)
    assert (row["id"], row["status"], row["target_id"]) == (measurement_id, "succeeded", kept)
    assert any_api.client.patch(address, json={"target_ids": [kept, gone]}).status_code == 200
    (job,) = queue.claim(1)
    assert [sought.target_id for sought in job.targets] == [kept, gone]


def test_a_target_taken_from_the_session_during_the_search_gets_no_row(any_api: Any, grey_png: bytes) -> None:
    """The image has a measurement of every target that is left, so that its search goes on."""
    queue = any_api.installation.queue
    session_id, (kept, gone), measurement_id = seek(any_api, grey_png, targets=2)
    by_name = any_api.put_image(session_id, grey_png, target_id=kept).json()["id"]
    (job,) = queue.claim(1)
    changed = any_api.client.patch(f"/v1/sessions/{session_id}", json={"target_ids": [kept]})
    assert changed.status_code == 200
    assert queue.finish([JobResult(job, shown(job, 1), 100.0)]) == 1
    row, named = any_api.measurements(session_id)
    assert (row["id"], named["id"]) == (measurement_id, by_name)
    assert (row["failure"]["code"], row["target_id"]) == ("target_not_found", None)
    assert f"shows {gone}" in row["failure"]["detail"]


def test_a_deleted_session_takes_the_search_with_it(any_api: Any, grey_png: bytes) -> None:
    queue = any_api.installation.queue
    session_id, _, _ = seek(any_api, grey_png)
    (job,) = queue.claim(1)
    assert any_api.client.delete(f"/v1/sessions/{session_id}").status_code == 204
    assert queue.finish([JobResult(job, shown(job, 0, 1), 100.0)]) == 0


def test_a_retry_looks_again_for_all(any_api: Any, grey_png: bytes) -> None:
    api, queue = any_api, any_api.installation.queue
    session_id, targets, measurement_id = seek(api, grey_png)

    def again(*places: int, failure: Failure | None = None) -> list[dict[str, Any]]:
        (job,) = queue.claim(9)
        assert [sought.target_id for sought in job.targets] == targets
        assert queue.finish([JobResult(job, shown(job, *places, failure=failure), 100.0)]) == 1
        return api.measurements(session_id)

    (nothing,) = again()
    assert (nothing["status"], nothing["target_id"]) == ("failed", None)
    retry = f"/v1/measurements/{measurement_id}/retry"
    assert api.client.post(retry).json()["target_id"] is None
    (one,) = again(1)
    assert (one["status"], one["target_id"]) == ("succeeded", targets[1])
    # The row keeps its target; those missed before become rows, those that have one keep it as it is.
    assert api.client.post(retry).json()["target_id"] == targets[1]
    one, two = again(0, 1)
    assert [m["target_id"] for m in (one, two)] == [targets[1], targets[0]]
    assert (one["duration_ms"], two["duration_ms"]) == (90.0, 10.0)
    queued = api.client.post(retry).json()
    assert queued["siblings"] == [two["id"]]
    one, unchanged, three = again(0, 2, failure=NOTHING)
    assert unchanged == {**two, "siblings": [one["id"], three["id"]]}
    assert (one["status"], one["failure"]["code"], one["target_id"]) == (
        "failed",
        "target_not_found",
        targets[1],
    )
    assert (three["status"], three["target_id"]) == ("failed", targets[2])
    # A sibling's retry is about its own target.
    assert api.client.post(f"/v1/measurements/{two['id']}/retry").status_code == 202
    (job,) = queue.claim(9)
    assert job.has_explicit_target
    assert [sought.target_id for sought in job.targets] == targets[:1]


def test_three_crashes_of_a_search_are_the_end_of_it(any_api: Any, grey_png: bytes) -> None:
    queue = any_api.installation.queue
    _, _, measurement_id = seek(any_api, grey_png)
    for _ in range(3):
        (job,) = queue.claim(1)
        queue.attempt_failed(job, WORKER_CRASHED, max_attempts=3)
    document = any_api.client.get(f"/v1/measurements/{measurement_id}").json()
    assert (document["status"], document["failure"]["code"]) == ("failed", "worker_crashed")
    assert document["target_id"] is None


def test_a_page_asks_as_often_for_many_siblings_as_for_few(api: Any, grey_png: bytes) -> None:
    queue = api.installation.queue
    targets = [api.make_target(columns=5 + k) for k in range(2)]
    sessions = [api.make_session(*targets), api.make_session(*targets)]
    for session_id, poses in zip(sessions, (1, 20), strict=True):
        for pose in range(poses):
            api.put_image(session_id, grey_png, f"P{pose}")
    while jobs := queue.claim(50):
        queue.finish([JobResult(job, shown(job, 0, 1), 100.0) for job in jobs])
    statements: list[str] = []

    def note(_connection: Any, _cursor: Any, statement: str, *_rest: Any) -> None:
        statements.append(statement)

    engines = {api.installation.database.engine, api.installation.database._reader}
    for engine in engines:
        sa.event.listen(engine, "before_cursor_execute", note)
    asked = []
    for session_id, items in zip(sessions, (2, 40), strict=True):
        tries = []
        for _ in range(4):  # the service's own chores may ask something meanwhile
            statements.clear()
            page = api.measurements(session_id)
            tries.append(list(statements))
            assert [len(m["siblings"]) for m in page] == [1] * items
        asked.append(min(tries, key=len))
    assert len(asked[0]) == len(asked[1])
    assert _reads_by_index(api, asked[1][-1])


def _reads_by_index(api: Any, statement: str) -> bool:
    """Return whether SQLite looks rows up by pose and hash, rather than reading a session's whole list."""
    fixed = statement
    while "?" in fixed:
        fixed = fixed.replace("?", "'x'", 1)
    with api.installation.database.read() as records:
        plan: Sequence[Any] = records.execute(sa.text(f"EXPLAIN QUERY PLAN {fixed}")).all()
    steps = " ".join(str(row) for row in plan)
    return "pose_id=?" in steps and "SCAN" not in steps
