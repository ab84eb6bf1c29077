"""A session is computed again: what is queued, in which portions, and what stays readable."""

from __future__ import annotations

from typing import Any

import pytest
import sqlalchemy as sa

from app.jobs.queue import JobResult, requeueing
from app.records.tables import AuditEntry
from app.services.measurements import retries
from tests.support.jobs.computations import DONE
from tests.support.jobs.searches import shown


def reprocess(api: Any, session_id: str, only: str) -> Any:
    return api.client.post(f"/v1/sessions/{session_id}/reprocess", json={"only": only})


@pytest.fixture
def filled(any_api: Any, grey_png: bytes) -> tuple[str, list[str]]:
    """A session with a measurement that succeeded, one that failed, one that runs and one that waits."""
    session_id = any_api.make_session(any_api.make_target(), any_api.make_target(columns=7))
    ids = [any_api.put_image(session_id, grey_png, f"P{k}").json()["id"] for k in range(4)]
    queue = any_api.installation.queue
    for place in ((0,), ()):
        (job,) = queue.claim(1)
        assert queue.finish([JobResult(job, shown(job, *place), 1.0)]) == 1
    queue.claim(1)
    return session_id, ids


@pytest.mark.parametrize("body", [{}, {"json": {}}, {"content": b""}])
def test_without_a_body_those_that_failed_are_computed_again(
    any_api: Any, filled: tuple[str, list[str]], body: dict[str, Any]
) -> None:
    session_id, ids = filled
    answer = any_api.client.post(f"/v1/sessions/{session_id}/reprocess", **body)
    assert (answer.status_code, answer.json()["requeued"]) == (202, 1)
    assert any_api.measurement(ids[1])["status"] == "queued"


@pytest.mark.parametrize("content_type", ["text/plain", "application/octet-stream"])
def test_a_body_that_is_no_json_is_refused_where_none_is_needed(
    any_api: Any, filled: tuple[str, list[str]], content_type: str
) -> None:
    path = f"/v1/sessions/{filled[0]}/reprocess"
    answer = any_api.client.post(path, content=b"all", headers={"Content-Type": content_type})
    assert (answer.status_code, answer.json()["code"]) == (415, "unsupported_media_type")


@pytest.mark.parametrize(("only", "queued"), [("failed", [1]), ("all", [0, 1, 2])])
def test_results_stay_until_they_are_replaced(
    any_api: Any, filled: tuple[str, list[str]], only: str, queued: list[int]
) -> None:
    session_id, ids = filled
    before = [any_api.measurement(i) for i in ids]
    answer = reprocess(any_api, session_id, only)
    assert (answer.status_code, answer.json()["requeued"]) == (202, len(queued))
    assert answer.headers["location"] == f"/v1/sessions/{session_id}"
    assert answer.json()["counts"] == any_api.client.get(f"/v1/sessions/{session_id}").json()["counts"]
    for place, (measurement_id, document) in enumerate(zip(ids, before, strict=True)):
        changes = {"status": "queued", "attempts": 0} if place in queued else {}
        assert any_api.measurement(measurement_id) == {**document, **changes}
    assert len(any_api.installation.queue.claim(9)) == len(queued) + 1


def test_what_runs_is_handed_out_anew_so_that_a_new_lens_counts(any_api: Any, grey_png: bytes) -> None:
    queue = any_api.installation.queue
    session_id = any_api.make_session()
    any_api.put_image(session_id, grey_png)
    (stale,) = queue.claim(1)
    lens = {"focal_length_mm": 8.0, "pixel_pitch_um": 3.45}
    assert any_api.client.patch(f"/v1/sessions/{session_id}", json={"lens": lens}).status_code == 200
    assert reprocess(any_api, session_id, "all").json()["requeued"] == 1
    assert queue.finish([JobResult(stale, DONE, 1.0)]) == 0
    (job,) = queue.claim(1)
    assert job.lens == lens


def test_many_are_queued_in_several_transactions_and_one_audit_entry(
    any_api: Any, grey_png: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(retries, "TOGETHER", 2)
    session_id = any_api.make_session()
    ids = [any_api.put_image(session_id, grey_png, f"P{k}").json()["id"] for k in range(5)]
    queue = any_api.installation.queue
    queue.finish([JobResult(job, DONE, 1.0) for job in queue.claim(9)])
    sizes: list[int] = []
    queue_rows = requeueing.queue_rows

    def counted(records: Any, some: Any, **changes: Any) -> None:
        sizes.append(len(some))
        queue_rows(records, some, **changes)

    monkeypatch.setattr(retries, "queue_rows", counted)
    assert reprocess(any_api, session_id, "failed").json()["requeued"] == 5
    assert sizes == [2, 2, 1]
    assert {any_api.measurement(i)["status"] for i in ids} == {"queued"}
    with any_api.installation.database.read() as records:
        entries = records.scalars(sa.select(AuditEntry).where(AuditEntry.action == "reprocess_session")).all()
    assert [entry.object_ids for entry in entries] == [[session_id]]
    assert reprocess(any_api, session_id, "failed").json()["requeued"] == 0


@pytest.mark.parametrize("body", [{"only": "some"}, {"only": None}, {"only": "all", "x": 1}, []])
def test_a_wrong_request_is_refused(api: Any, body: Any) -> None:
    response = api.client.post(f"/v1/sessions/{api.make_session()}/reprocess", json=body)
    assert (response.status_code, response.json()["code"]) == (422, "invalid_request")
