"""Transactions that come together: one commit, each one's failure its own, and nothing answered that is not stored."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import sqlalchemy as sa

from app.errors import InvalidContent, ServiceError, StorageFull
from app.records.database import Database, sqlite_driver
from app.records.statements import Rows, Statement

DRIVER, _ = sqlite_driver()
_ADD = Statement(sa.text("INSERT INTO things (name) VALUES (:name)").bindparams(name=""))
_ALL = sa.text("SELECT name FROM things ORDER BY name")


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    database = Database(f"sqlite:///{tmp_path / 'things.sqlite3'}")
    with database.engine.begin() as connection:
        connection.exec_driver_sql("CREATE TABLE things (name TEXT PRIMARY KEY)")
    yield database
    database.dispose()


def names(database: Database) -> list[str]:
    with database.read() as records:
        return list(records.scalars(_ALL))


def add(name: str) -> Callable[[Rows], str]:
    def work(rows: Rows) -> str:
        rows.all(_ADD, name=name)
        return name

    return work


def together(database: Database, works: list[Callable[[Rows], str]]) -> list[str | Exception]:
    """Do work while the writer is taken, so that all of it waits for one transaction."""

    def run(work: Callable[[Rows], str]) -> str | Exception:
        try:
            return database.write_together(work)
        except (ServiceError, sa.exc.DBAPIError, DRIVER.Error) as error:
            return error

    with ThreadPoolExecutor(len(works)) as pool:
        with database.write_rows():
            futures = [pool.submit(run, work) for work in works]
            while len(database._group._waiting) < len(works):
                threading.Event().wait(0.001)
        return [future.result() for future in futures]


def test_what_comes_together_is_committed_together(database: Database) -> None:
    commits = []

    def note(statement: str) -> None:
        if statement == "COMMIT":
            commits.append(statement)

    with database.engine.connect() as connection:
        connection.connection.driver_connection.set_trace_callback(note)  # type: ignore[union-attr]
    wanted = [f"n{number}" for number in range(6)]
    assert together(database, [add(name) for name in wanted]) == wanted
    assert names(database) == wanted
    assert len(commits) == 2, "the writer that was waited for, then all of them"


def test_one_that_fails_undoes_nothing_of_the_others(database: Database) -> None:
    def refuse(rows: Rows) -> str:
        rows.all(_ADD, name="refused")
        raise InvalidContent("no")

    first, refused, twice, last = together(database, [add("a"), refuse, add("a"), add("b")])
    assert isinstance(refused, InvalidContent)
    assert [isinstance(each, Exception) for each in (first, twice)].count(True) == 1
    assert last == "b"
    assert names(database) == ["a", "b"]


def test_a_commit_that_fails_is_everybodys(database: Database) -> None:
    """The database has no room: SQLite undoes the whole transaction, and no client is answered that it was stored."""
    with database.engine.connect() as connection:
        pages = connection.exec_driver_sql("PRAGMA page_count").scalar()
        connection.exec_driver_sql(f"PRAGMA max_page_count={pages}")
    answers = together(database, [add(f"{number}" + "x" * 3000) for number in range(4)])
    assert any(isinstance(answer, StorageFull) for answer in answers)
    stored = {answer for answer in answers if isinstance(answer, str)}
    assert set(names(database)) == stored
    with database.engine.connect() as connection:
        connection.exec_driver_sql("PRAGMA max_page_count=100000")
    assert database.write_together(add("later")) == "later"
