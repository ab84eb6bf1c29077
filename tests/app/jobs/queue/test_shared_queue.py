"""The queue of several workers on PostgreSQL: each job is done once, also when the worker that had it is gone."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest
import sqlalchemy as sa

from app.jobs.queue import Job, JobResult, queue_of
from app.jobs.queue.procrastinate_queue import MAX_RESCUES, ProcrastinateQueue
from app.records import migrations
from app.records.database import Database
from app.records.outcome import Failure, Outcome
from app.records.tables import Measurement, Session
from tests.support.environment.postgres import new_database
from tests.support.jobs.queued_rows import enqueue, make_session
from tests.support.service.service import wait_until

pytestmark = [pytest.mark.postgres, pytest.mark.slow]

NOTHING = Outcome(None, Failure("target_not_found", "Nothing there.", None))
RESCUED_WITHIN_S = 30.0
SLACK_S = 60.0
"""What a busy build server adds."""
HOLDER = """
import sys, time
from app.jobs.queue.procrastinate_queue import ProcrastinateQueue
from app.records.database import Database
queue = ProcrastinateQueue(Database(sys.argv[1]))
queue.start_fetching(2)
while not queue.claim(1):
    queue.wait(0.1)
print("claimed", flush=True)
time.sleep(600)
"""


@pytest.fixture(scope="module")
def migrated(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with new_database() as url:
        database = Database(url)
        migrations.upgrade(database, tmp_path_factory.mktemp("migrated"))
        database.dispose()
        yield url


@pytest.fixture
def database(migrated: str) -> Iterator[Database]:
    with new_database(migrated) as url:
        database = Database(url)
        yield database
        database.dispose()


@pytest.fixture
def start(database: Database) -> Iterator[Callable[[], ProcrastinateQueue]]:
    """Return what starts a further worker's queue, as if on another machine."""
    queues = []

    def run() -> ProcrastinateQueue:
        queue = queue_of(Database(database.url))
        assert isinstance(queue, ProcrastinateQueue)
        queue.start_fetching(2)
        queues.append(queue)
        return queue

    yield run
    for queue in queues:
        queue.stop_fetching()
        queue._database.dispose()


def claimed(queue: ProcrastinateQueue, jobs: int, within_s: float = 120.0) -> list[Job]:
    found: list[Job] = []
    deadline = time.monotonic() + within_s
    while len(found) < jobs and time.monotonic() < deadline:
        found += queue.claim(jobs - len(found))
        queue.wait(0.05)
    assert len(found) == jobs, f"{len(found)} of {jobs} jobs after {within_s} s"
    return found


def finish(queue: ProcrastinateQueue, jobs: Sequence[Job]) -> int:
    return queue.finish([JobResult(job, NOTHING, 1.0) for job in jobs])


def statuses(database: Database) -> dict[str, int]:
    with database.read() as records:
        rows = records.execute(sa.select(Measurement.status, sa.func.count()).group_by(Measurement.status))
        return {row[0]: row[1] for row in rows}


def jobs_left(database: Database) -> int:
    with database.read() as records:
        statement = "SELECT count(*) FROM procrastinate_jobs WHERE queue_name = 'images'"
        return int(records.scalar(sa.text(statement)) or 0)


def test_a_row_and_its_job_are_committed_or_undone_together(database: Database) -> None:
    session_id = make_session(database)
    enqueue(database, session_id, 3)
    assert jobs_left(database) == 3
    with database.engine.connect() as connection:
        connection.execute(sa.update(Measurement).values(status="running"))
        connection.execute(sa.text("DELETE FROM procrastinate_jobs"))
        connection.execute(sa.update(Measurement).values(status="queued"))
        assert connection.scalar(sa.text("SELECT count(*) FROM procrastinate_jobs")) == 3
        connection.execute(sa.text("DELETE FROM procrastinate_jobs"))
        connection.rollback()
    assert jobs_left(database) == 3


def test_two_workers_share_the_images_and_do_each_once(
    database: Database, start: Callable[[], ProcrastinateQueue]
) -> None:
    one, other = start(), start()
    ids = enqueue(database, make_session(database), 40)
    done: list[str] = []
    deadline = time.monotonic() + 120.0
    while len(done) < len(ids) and time.monotonic() < deadline:
        for queue in (one, other):
            jobs = queue.claim(2)
            assert finish(queue, jobs) == len(jobs)
            done += [job.measurement_id for job in jobs]
        one.wait(0.01)
    assert sorted(done) == sorted(ids)
    assert statuses(database) == {"failed": 40}
    wait_until(lambda: jobs_left(database) == 0, 120.0, "every job is gone")


def test_images_of_a_second_session_do_not_wait_for_a_thousand_of_the_first(
    database: Database, start: Callable[[], ProcrastinateQueue]
) -> None:
    enqueue(database, make_session(database), 1000)
    ten = set(enqueue(database, make_session(database), 10))
    queue = start()
    order: list[str] = []
    while len(order) < 30:
        jobs = claimed(queue, 1)
        finish(queue, jobs)
        order += [job.measurement_id for job in jobs]
    places = [place for place, measurement_id in enumerate(order) if measurement_id in ten]
    assert len(places) == 10, "ten images are served"
    assert places[-1] < 25, "within the first turns of both sessions"


def test_a_session_that_was_idle_has_no_credit_and_a_busy_one_no_debt(
    database: Database, start: Callable[[], ProcrastinateQueue]
) -> None:
    busy, fresh = make_session(database), make_session(database)
    queue = start()
    enqueue(database, busy, 50)
    for _ in range(50):
        finish(queue, claimed(queue, 1))
    wait_until(lambda: jobs_left(database) == 0, 120.0, "the queue is empty")
    of_fresh = enqueue(database, fresh, 20)
    of_busy = enqueue(database, busy, 20)
    order = []
    for _ in range(20):
        (job,) = claimed(queue, 1)
        finish(queue, [job])
        order.append(job.measurement_id)
    assert 6 <= sum(i in of_busy for i in order) <= 12
    assert 6 <= sum(i in of_fresh for i in order) <= 14


def test_turns_begin_again_before_priorities_overflow(
    database: Database, start: Callable[[], ProcrastinateQueue]
) -> None:
    session_id = make_session(database)
    enqueue(database, session_id, 1)
    queue = start()
    finish(queue, claimed(queue, 1))
    wait_until(lambda: jobs_left(database) == 0, 120.0, "the queue is empty")
    with database.write() as records:
        records.execute(sa.text("SELECT setval('queue_clock', 2147483000)"))
        records.execute(sa.text("UPDATE queue_turns SET last = 2147483000"))
    enqueue(database, session_id, 1000)
    with database.read() as records:
        assert records.scalar(sa.text("SELECT min(priority) FROM procrastinate_jobs")) == -1000


def test_a_killed_worker_s_job_is_done_by_another(
    database: Database, start: Callable[[], ProcrastinateQueue]
) -> None:
    (measurement_id,) = enqueue(database, make_session(database), 1)
    url = database.url.render_as_string(hide_password=False)
    with subprocess.Popen([sys.executable, "-c", HOLDER, url], stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "claimed\n"
        other = start()
        holder.send_signal(signal.SIGKILL)
        holder.wait()
        killed = time.monotonic()
        (job,) = claimed(other, 1, RESCUED_WITHIN_S + SLACK_S)
        assert job.measurement_id == measurement_id
        assert finish(other, [job]) == 1
        assert time.monotonic() - killed < RESCUED_WITHIN_S + SLACK_S


def test_a_result_of_a_worker_that_was_given_up_is_dropped(
    database: Database, start: Callable[[], ProcrastinateQueue]
) -> None:
    enqueue(database, make_session(database), 1)
    slow = start()
    (job,) = claimed(slow, 1)
    with database.write() as records:  # what the rescue does
        records.execute(sa.text("UPDATE procrastinate_jobs SET status = 'todo', attempts = attempts + 1"))
    other = start()
    (again,) = claimed(other, 1)
    assert again.claim != job.claim
    assert finish(slow, [job]) == 0
    assert finish(other, [again]) == 1
    assert statuses(database) == {"failed": 1}


def test_an_image_that_takes_workers_down_fails_in_the_end(
    database: Database, start: Callable[[], ProcrastinateQueue]
) -> None:
    enqueue(database, make_session(database), 1)
    with database.write() as records:
        records.execute(sa.text("UPDATE procrastinate_jobs SET attempts = :n"), {"n": MAX_RESCUES + 1})
    queue = start()
    wait_until(lambda: not queue.claim(1) and statuses(database) == {"failed": 1}, 120.0, "it fails")
    with database.read() as records:
        assert records.scalar(sa.select(Measurement.failure_code)) == "worker_crashed"


def test_what_a_worker_gives_back_is_done_by_another(
    database: Database, start: Callable[[], ProcrastinateQueue]
) -> None:
    enqueue(database, make_session(database), 6)
    leaving = start()
    jobs = claimed(leaving, 2)
    leaving.release(jobs)
    leaving.stop_fetching()
    other = start()
    for _ in range(6):
        assert finish(other, claimed(other, 1)) == 1
    with database.read() as records:
        assert set(records.scalars(sa.select(Measurement.attempts))) == {1}, "giving back counts no attempt"


def test_rows_without_jobs_are_found(database: Database) -> None:
    ids = enqueue(database, make_session(database), 3)
    with database.write() as records:
        records.execute(sa.text("DELETE FROM procrastinate_jobs"))
        records.execute(sa.update(Measurement).where(Measurement.id == ids[0]).values(status="running"))
    queue = queue_of(database)
    assert (queue.recover(), queue.recover()) == (3, 0)
    assert (jobs_left(database), statuses(database)) == (3, {"queued": 3})


def test_a_deleted_session_leaves_no_work(
    database: Database, start: Callable[[], ProcrastinateQueue]
) -> None:
    session_id = make_session(database)
    enqueue(database, session_id, 3)
    with database.write() as records:
        records.execute(sa.delete(Session).where(Session.id == session_id))
    queue = start()
    wait_until(lambda: not queue.claim(3) and jobs_left(database) == 0, 120.0, "the jobs are gone")


def test_the_queue_survives_lost_connections(
    database: Database, start: Callable[[], ProcrastinateQueue], tmp_path: Path
) -> None:
    queue = start()
    session_id = make_session(database)
    enqueue(database, session_id, 1)
    finish(queue, claimed(queue, 1))
    end_others = sa.text(
        "SELECT pg_terminate_backend(pid) FROM pg_stat_activity "
        "WHERE datname = current_database() AND pid <> pg_backend_pid()"
    )
    with database.engine.connect() as connection:
        connection.execute(end_others)
    enqueue(database, session_id, 4)
    assert finish(queue, claimed(queue, 4)) == 4
