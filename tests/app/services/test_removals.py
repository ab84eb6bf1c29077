"""Originals whose rows are deleted are removed, and uploads of the same bytes win against that."""

from __future__ import annotations

import contextlib
import hashlib
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from app.errors import Unavailable
from app.jobs.queue import JobResult, sql_queue
from app.jobs.queue.saving import save_result
from app.records.outcome import Failure, Outcome
from app.records.tables import Measurement
from app.services.maintenance.chores import Maintenance, Round, chores
from app.services.maintenance.orphans import MAX_STEP_S
from app.services.originals import finish_removals, record_removals
from app.services.sessions import delete_session
from tests.support.service.originals import fill, forget, new_sweep, open_elsewhere, originals, recorded


def named(api: Any) -> set[str]:
    with api.installation.database.read() as records:
        return set(records.scalars(sa.select(Measurement.sha256)))


def test_a_refused_unlink_fails_no_request_and_is_made_up_for(
    any_api: Any, grey_png: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The rows were gone, the request failed, and nobody knew of the files any more."""
    session_id, hashes = fill(any_api, grey_png)
    with open_elsewhere(monkeypatch):
        assert any_api.client.delete(f"/v1/sessions/{session_id}").status_code == 204
        assert any_api.client.get(f"/v1/sessions/{session_id}").status_code == 404
        assert originals(any_api) == recorded(any_api) == hashes
        assert finish_removals(any_api.installation.database, any_api.installation.blobs) == 0
        assert recorded(any_api) == hashes
    any_api.service.maintenance.run_once()
    assert originals(any_api) == recorded(any_api) == set()


def test_a_deletion_that_was_killed_is_finished_at_the_next_start(
    open_api: Any, grey_png: bytes, tmp_path: Path
) -> None:
    with open_api(tmp_path / "data") as running:
        session_id, hashes = fill(running, grey_png)
        kept = running.put_image(running.make_session(), grey_png + b"0").json()["sha256"]
        forget(running, session_id)
        assert originals(running) == recorded(running) == hashes
    with open_api(tmp_path / "data") as running:
        deadline = time.monotonic() + 60.0
        while recorded(running):
            assert time.monotonic() < deadline
            running.service.maintenance.run_once()
        assert originals(running) == {kept}


def test_the_record_is_part_of_the_deletion(any_api: Any, grey_png: bytes) -> None:
    session_id, hashes = fill(any_api, grey_png)
    with contextlib.suppress(RuntimeError), any_api.installation.database.write() as records:
        assert set(record_removals(records, Measurement.session_id == session_id)) == hashes
        raise RuntimeError
    assert recorded(any_api) == set()
    assert originals(any_api) == hashes


def test_a_database_that_fails_after_the_deletion_fails_no_request(
    api: Any, grey_png: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    session_id, hashes = fill(api, grey_png)
    database = api.installation.database

    def refuse() -> Any:
        raise Unavailable("The database is busy.")

    with monkeypatch.context() as patched:
        patched.setattr(database, "_read_session", refuse)
        delete_session(database, api.installation.blobs, session_id)
    assert recorded(api) == originals(api) == hashes
    api.service.maintenance.run_once()
    assert recorded(api) == originals(api) == set()


def test_a_file_recorded_again_while_it_is_removed_stays_recorded(any_api: Any, grey_png: bytes) -> None:
    """Uploaded and deleted once more between the removal and the end of its record, an image would be forgotten."""
    database, blobs = any_api.installation.database, any_api.installation.blobs
    session_id, (sha256,) = fill(any_api, grey_png, 1)
    again = any_api.make_session()
    assert any_api.client.put(f"/v1/sessions/{again}/poses/P1", json={}).status_code == 201
    with database.read() as records:
        (measurement,) = records.scalars(sa.select(Measurement)).all()
        row = {column.name: getattr(measurement, column.name) for column in Measurement.__table__.columns}
    forget(any_api, session_id)
    remove = blobs.remove

    def remove_and_meet_it_again(name: str) -> bool:
        blobs.remove = remove
        removed: bool = remove(name)
        staged = blobs.stage()
        staged.write(grey_png + b"0")
        blobs.publish(staged)
        staged.discard()
        with database.write() as records:
            records.add(Measurement(**{**row, "session_id": again}))
        forget(any_api, again)
        return removed

    blobs.remove = remove_and_meet_it_again
    finish_removals(database, blobs)
    assert recorded(any_api) == originals(any_api) == {sha256}
    finish_removals(database, blobs)
    assert recorded(any_api) == originals(any_api) == set()


@pytest.mark.slow
def test_uploads_win_against_deletions_and_sweeps_of_the_same_bytes(any_api: Any, grey_png: bytes) -> None:
    """Threads that upload, delete and tidy the same few images: no row without its file, no orphaned file."""
    installation = any_api.installation
    database, blobs = installation.database, installation.blobs
    target_id = any_api.make_target()
    images = [grey_png + b"%d" % number for number in range(3)]
    over = threading.Event()

    def upload_and_delete(number: int) -> None:
        for turn in range(12):
            session_id = any_api.make_session(target_id)
            for data in images:
                response = any_api.put_image(session_id, data)
                assert response.status_code == 202, response.text
                assert blobs.path(hashlib.sha256(data).hexdigest()).read_bytes() == data
            if (turn + number) % 4:
                assert any_api.client.delete(f"/v1/sessions/{session_id}").status_code == 204

    def tidy() -> None:
        sweep = new_sweep(any_api)
        while not over.is_set():
            finish_removals(database, blobs)
            for hours in range(30):
                sweep.run(time.time() + hours * MAX_STEP_S)

    with ThreadPoolExecutor(5) as pool:
        tidying = [pool.submit(tidy) for _ in range(2)]
        uploading = [pool.submit(upload_and_delete, number) for number in range(3)]
        try:
            for future in uploading:
                future.result()
        finally:
            over.set()
        for future in tidying:
            future.result()
    assert named(any_api) <= originals(any_api)
    finish_removals(database, blobs)
    assert recorded(any_api) == set()
    assert originals(any_api) == named(any_api)


def test_an_upload_that_cannot_be_tidied_away_now_is_later(
    api: Any, grey_png: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    session_id = api.make_session()
    with open_elsewhere(monkeypatch):
        wrong = api.client.put(f"/v1/sessions/{session_id}/poses/P1/images/{'0' * 64}", content=grey_png)
        assert (wrong.status_code, wrong.json()["code"]) == (422, "hash_mismatch")
    incoming = api.installation.blobs.root / "incoming"
    assert len(list(incoming.iterdir())) == 1
    api.service.maintenance.run_once()
    assert list(incoming.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("reverse", [False, True])
def test_results_that_are_saved_while_their_session_is_deleted(
    any_api: Any, grey_png: bytes, monkeypatch: pytest.MonkeyPatch, reverse: bool
) -> None:
    """PostgreSQL used to end one of the two: each waited for a row that the other had."""
    session_id, _ = fill(any_api, grey_png, 2)
    queue = any_api.installation.queue
    jobs = sorted(queue.claim(4), key=lambda job: job.measurement_id, reverse=reverse)
    assert [job.has_explicit_target for job in jobs] == [True, True]
    nothing = Outcome(None, Failure("target_not_found", "Nothing there.", None))
    half, save = threading.Event(), save_result

    def save_slowly(*arguments: Any, **options: Any) -> bool:
        saved = save(*arguments, **options)
        half.set()
        time.sleep(1.5)
        return saved

    monkeypatch.setattr(sql_queue, "save_result", save_slowly)
    with ThreadPoolExecutor(1) as pool:
        saving = pool.submit(queue.finish, [JobResult(job, nothing, 1.0) for job in jobs])
        assert half.wait(60.0)
        assert any_api.client.delete(f"/v1/sessions/{session_id}").status_code == 204
        assert saving.result() == 2


def test_a_chore_that_fails_ends_nothing(api: Any) -> None:
    done: list[str] = []
    twice = threading.Event()

    def fail(_turn: Round) -> None:
        done.append("failing")
        raise RuntimeError("a defect")

    def put_off(_turn: Round) -> None:
        raise Unavailable("The database is busy.")

    def finish(_turn: Round) -> None:
        done.append("last")
        if len(done) >= 4:
            twice.set()

    maintenance = Maintenance([("fail", fail), ("put_off", put_off), ("finish", finish)], interval_s=0.01)
    maintenance.start()
    assert twice.wait(60.0)
    maintenance.stop()
    assert done[:4] == ["failing", "last", "failing", "last"]
    assert [name for name, _ in chores(api.installation)] == [
        *("finish_removals", "sweep_orphans", "sweep_unfinished", "retention")
    ]
