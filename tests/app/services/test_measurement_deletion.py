"""A deleted measurement is gone with its original, whoever computes it and whatever is killed meanwhile."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa

from app.jobs.queue import JobResult
from app.records.tables import Measurement, Removal, Result
from app.services.originals import record_removals
from tests.support.jobs.computations import DONE
from tests.support.jobs.searches import seek, shown
from tests.support.service.originals import open_elsewhere


def delete(api: Any, measurement_id: str) -> None:
    response = api.client.delete(f"/v1/measurements/{measurement_id}")
    assert (response.status_code, response.content) == (204, b"")
    assert api.client.get(f"/v1/measurements/{measurement_id}").status_code == 404


def original(api: Any, sha256: str) -> Any:
    return api.installation.blobs.path(sha256)


def test_the_original_goes_with_its_last_measurement(any_api: Any, grey_png: bytes) -> None:
    first = any_api.put_image(any_api.make_session(), grey_png).json()
    second = any_api.put_image(any_api.make_session(), grey_png).json()
    delete(any_api, first["id"])
    assert original(any_api, first["sha256"]).read_bytes() == grey_png
    delete(any_api, second["id"])
    assert not original(any_api, first["sha256"]).exists()
    assert any_api.client.delete(f"/v1/measurements/{first['id']}").status_code == 404
    found = any_api.client.get("/v1/audit", params={"object_id": first["id"]}).json()["items"]
    assert [entry["action"] for entry in found] == ["put_image", "delete_measurement"]


def test_a_job_that_runs_does_not_bring_it_back(any_api: Any, grey_png: bytes) -> None:
    queue = any_api.installation.queue
    session_id = any_api.make_session()
    measurement_id = any_api.put_image(session_id, grey_png).json()["id"]
    (job,) = queue.claim(1)
    delete(any_api, measurement_id)
    assert queue.finish([JobResult(job, DONE, 1.0)]) == 0
    queue.attempt_failed(job, DONE.failure, max_attempts=1)
    queue.release([job])
    assert any_api.measurements(session_id) == []
    with any_api.installation.database.read() as records:
        assert records.scalars(sa.select(Result.measurement_id)).all() == []


def test_a_search_of_its_image_does_not_bring_it_back(any_api: Any, grey_png: bytes) -> None:
    queue = any_api.installation.queue
    session_id, targets, first = seek(any_api, grey_png, targets=2)
    (job,) = queue.claim(1)
    queue.finish([JobResult(job, shown(job, 0, 1), 1.0)])
    _, second = any_api.measurements(session_id)
    retry = f"/v1/measurements/{first}/retry"
    assert any_api.client.post(retry).status_code == 202
    (job,) = queue.claim(1)
    delete(any_api, second["id"])
    assert queue.finish([JobResult(job, shown(job, 0, 1), 1.0)]) == 1
    assert any_api.client.post(retry).status_code == 202
    (job,) = queue.claim(1)
    assert [sought.target_id for sought in job.targets] == targets[:1]
    queue.release([job])
    assert [m["id"] for m in any_api.measurements(session_id)] == [first]


def test_a_row_that_only_refers_to_it_goes_with_it(any_api: Any, grey_png: bytes) -> None:
    queue = any_api.installation.queue
    session_id, targets, _ = seek(any_api, grey_png, targets=2)
    named = any_api.put_image(session_id, grey_png, target_id=targets[0]).json()
    for job in queue.claim(2):
        queue.finish([JobResult(job, shown(job, 0), 1.0)])
    assert [m["target_id"] for m in any_api.measurements(session_id)] == [None, targets[0]]
    delete(any_api, named["id"])
    assert any_api.measurements(session_id) == []
    assert not original(any_api, named["sha256"]).exists()


def test_a_refused_unlink_is_made_up_for(any_api: Any, grey_png: bytes, monkeypatch: Any) -> None:
    measurement = any_api.put_image(any_api.make_session(), grey_png).json()
    with open_elsewhere(monkeypatch):
        delete(any_api, measurement["id"])
        assert original(any_api, measurement["sha256"]).exists()
    any_api.service.maintenance.run_once()
    assert not original(any_api, measurement["sha256"]).exists()


def test_a_deletion_killed_before_the_file_went_is_finished_later(any_api: Any, grey_png: bytes) -> None:
    measurement = any_api.put_image(any_api.make_session(), grey_png).json()
    with any_api.installation.database.write() as records:  # as far as a process comes that is killed then
        which = Measurement.id == measurement["id"]
        assert record_removals(records, which) == [measurement["sha256"]]
        records.execute(sa.delete(Measurement).where(which))
    assert original(any_api, measurement["sha256"]).exists()
    any_api.service.maintenance.run_once()
    assert not original(any_api, measurement["sha256"]).exists()
    with any_api.installation.database.read() as records:
        assert records.scalars(sa.select(Removal)).all() == []


def test_the_same_image_can_be_sent_again(any_api: Any, grey_png: bytes) -> None:
    session_id = any_api.make_session()
    first = any_api.put_image(session_id, grey_png).json()
    delete(any_api, first["id"])
    ask = {"images": [{"pose_id": "P1", "sha256": first["sha256"]}]}
    missing = any_api.client.post(f"/v1/sessions/{session_id}/images/missing", json=ask).json()["missing"]
    assert len(missing) == 1
    again = any_api.put_image(session_id, grey_png)
    assert (again.status_code, again.json()["id"] != first["id"]) == (202, True)


def test_a_damaged_row_can_be_deleted_as_its_advice_says(any_api: Any, grey_png: bytes) -> None:
    session_id = any_api.make_session()
    measurement = any_api.put_image(session_id, grey_png).json()
    with any_api.installation.database.write() as records:
        records.execute(sa.update(Measurement).values(sha256="../../etc/passwd"))
    assert any_api.measurement(measurement["id"])["failure"]["code"] == "row_unreadable"
    delete(any_api, measurement["id"])
    any_api.service.maintenance.run_once()
    with any_api.installation.database.read() as records:
        assert records.scalars(sa.select(Removal)).all() == []
    assert any_api.put_image(session_id, grey_png).status_code == 202
