"""Fair shares: sessions take turns at the queue, each one's images in the order they came."""

from __future__ import annotations

import shutil
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import settings as given_settings
from hypothesis import strategies as st

from app.jobs.queue.sql_queue import SqlQueue
from app.records import migrations
from app.records.database import Database
from tests.support.environment.postgres import EITHER_DATABASE
from tests.support.jobs.queued_rows import enqueue, make_session

MANY = 1_000
"""Images of the large session in the smaller tier; ten times as many in the larger."""


@pytest.fixture(params=EITHER_DATABASE)
def database(request: pytest.FixtureRequest, empty_data_dir: Path, tmp_path: Path) -> Iterator[Database]:
    """A database with no rows, of either kind."""
    if request.param == "sqlite":
        shutil.copytree(empty_data_dir, tmp_path / "data")
        database = Database(f"sqlite:///{tmp_path / 'data' / 'gridpose.sqlite3'}")
    else:
        database = Database(request.getfixturevalue("postgres_url"))
        migrations.upgrade(database, tmp_path)
    yield database
    database.dispose()


def claim(queue: SqlQueue, limit: int) -> list[str]:
    return [job.measurement_id for job in queue.claim(limit)]


@pytest.mark.parametrize(
    ("many", "lookahead"),
    [(MANY, 1), (MANY, 8), pytest.param(4 * MANY, 8, marks=pytest.mark.slow)],
)
def test_ten_images_behind_many_are_computed_at_once(database: Database, many: int, lookahead: int) -> None:
    queue = SqlQueue(database)
    large = make_session(database)
    first = enqueue(database, large, many)
    assert claim(queue, lookahead) == first[:lookahead]
    small = enqueue(database, make_session(database), 10)
    served: list[str] = []
    while not set(small) <= set(served):
        served += claim(queue, lookahead)
        assert len(served) <= 20 + lookahead
    assert small[0] in served[:2]
    assert [i for i in served if i in small] == small
    of_large = [i for i in served if i not in small]
    assert of_large == first[lookahead : lookahead + len(of_large)]
    assert len(of_large) >= 9  # nor does the large one wait for the small one


def test_every_session_waits_for_one_round_at_most(database: Database) -> None:
    queue = SqlQueue(database)
    sessions = [make_session(database) for _ in range(7)]
    queued = {session_id: enqueue(database, session_id, 4) for session_id in sessions}
    of = {i: session_id for session_id, ids in queued.items() for i in ids}
    served = []
    while claimed := claim(queue, 3):
        served += claimed
    for start in range(0, 28, 7):
        assert [of[i] for i in served[start : start + 7]] == sessions
    for session_id in sessions:
        assert [i for i in served if of[i] == session_id] == queued[session_id]


def test_two_runners_share_one_queue(database: Database) -> None:
    one, other = SqlQueue(database), SqlQueue(database)
    sessions = [make_session(database) for _ in range(3)]
    queued = [i for session_id in sessions for i in enqueue(database, session_id, 5)]
    served: list[str] = []
    while claimed := claim(one, 2) + claim(other, 2):
        served += claimed
    assert sorted(served) == sorted(queued)
    assert set(queued[::5]) <= set(served[:6])


def test_jobs_given_back_keep_their_place_in_their_session(database: Database) -> None:
    queue = SqlQueue(database)
    ids = enqueue(database, make_session(database), 6)
    jobs = queue.claim(4)
    queue.release(jobs[1:])
    assert claim(queue, 6) == ids[1:]


@pytest.mark.parametrize("many", [MANY, pytest.param(10 * MANY, marks=pytest.mark.slow)])
def test_a_claim_walks_the_index_alone(database: Database, many: int) -> None:
    """Whatever is queued: the cost of a claim is that of a few steps of the index."""
    if not database.is_sqlite:
        pytest.skip("SQLite counts the steps of its machine")
    queue = SqlQueue(database)
    large = make_session(database)
    steps = []
    with database.engine.connect() as connection:
        driver = connection.connection.driver_connection
        assert driver is not None
    for images in (20, many):
        enqueue(database, large, images)
        enqueue(database, make_session(database), images)
        count = [0]
        driver.set_progress_handler(lambda count=count: count.__setitem__(0, count[0] + 1), 10)
        assert len(claim(queue, 8)) == 8
        driver.set_progress_handler(None, 0)
        steps.append(count[0])
    assert steps[1] <= 1.5 * steps[0], steps


@given_settings(max_examples=15)
@given(
    arrivals=st.lists(
        st.tuples(st.integers(0, 4), st.integers(1, 6), st.integers(0, 5)), min_size=1, max_size=12
    )
)
def test_no_order_of_arrivals_starves_a_session(
    empty_data_dir: Path, tmp_path_factory: pytest.TempPathFactory, arrivals: list[tuple[int, int, int]]
) -> None:
    """After each arrival (session, images) so many jobs are claimed; then the rest."""
    folder = tmp_path_factory.mktemp("queue") / "data"
    shutil.copytree(empty_data_dir, folder)
    database = Database(f"sqlite:///{folder / 'gridpose.sqlite3'}")
    queue, sessions = SqlQueue(database), [make_session(database) for _ in range(5)]
    waiting: defaultdict[int, list[str]] = defaultdict(list)
    passed: defaultdict[int, int] = defaultdict(int)

    def serve(limit: int) -> int:
        claimed = claim(queue, limit)
        for measurement_id in claimed:
            (served,) = (k for k, ids in waiting.items() if measurement_id in ids)
            assert waiting[served].pop(0) == measurement_id  # the oldest of its session
            passed[served] = 0
            for other, ids in waiting.items():
                if ids and other != served:
                    passed[other] += 1
                    assert passed[other] < len(sessions)  # every session has its turn within one round
        return len(claimed)

    for session, images, claims in arrivals:
        if not waiting[session]:
            passed[session] = 0
        waiting[session] += enqueue(database, sessions[session], images)
        if claims:
            serve(claims)
    while serve(3):
        pass
    assert not any(waiting.values())
    database.dispose()
