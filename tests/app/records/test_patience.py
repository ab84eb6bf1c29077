"""Writers wait for another program that has the database, until the service is to end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import sqlalchemy as sa

from app.errors import Unavailable
from app.records.database import Database, sqlite_driver

DRIVER, _ = sqlite_driver()
WRITE = "INSERT INTO things VALUES (1)"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "things.sqlite3"


@pytest.fixture
def database(path: Path) -> Iterator[Database]:
    made = Database(f"sqlite:///{path}")
    with made.engine.begin() as connection:
        connection.exec_driver_sql("CREATE TABLE things (number INTEGER)")
    yield made
    made.dispose()


@pytest.fixture(params=["by the ORM", "below it"])
def write(request: pytest.FixtureRequest, database: Database) -> Callable[[], None]:
    def by_orm() -> None:
        with database.write() as records:
            records.execute(sa.text(WRITE))

    def below() -> None:
        with database.write_rows():
            pass

    return by_orm if request.param == "by the ORM" else below


def test_a_writer_waits_for_another_program(path: Path, write: Callable[[], None]) -> None:
    other = DRIVER.connect(path, isolation_level=None, check_same_thread=False)
    other.execute("BEGIN EXCLUSIVE")
    with ThreadPoolExecutor() as pool:
        writing = pool.submit(write)
        with pytest.raises(TimeoutError):
            writing.result(timeout=1.0)
        other.execute("ROLLBACK")
        writing.result(timeout=60.0)
    other.close()


def test_whoever_waits_when_the_service_ends_waits_no_longer(
    path: Path, database: Database, write: Callable[[], None]
) -> None:
    """SIGTERM took 77 s while another program held the database: each part waited for 20 s, one after another."""
    other = DRIVER.connect(path, isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    with ThreadPoolExecutor() as pool:
        writing = [pool.submit(write) for _ in range(3)]
        with pytest.raises(TimeoutError):
            writing[0].result(timeout=1.0)
        database.patience.end_within(0.0)
        for one in writing:
            with pytest.raises(Unavailable):
                one.result(timeout=15.0)  # 20 s, had it its patience
    other.close()
