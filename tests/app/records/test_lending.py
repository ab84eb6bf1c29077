"""Connections lent by the pool below SQLAlchemy's own wrapper: one at a time, and none within a transaction."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import sqlalchemy as sa

from app.records.database import sqlite_driver
from app.records.database.engines import sqlite_engine
from app.records.database.lending import LendingPool

DRIVER, _ = sqlite_driver()


@pytest.fixture
def engine(tmp_path: Path) -> Iterator[sa.Engine]:
    url = sa.make_url(f"sqlite:///{tmp_path / 'things.sqlite3'}")
    engine = sqlite_engine(url, begin="BEGIN IMMEDIATE", connections=1)
    with engine.begin() as connection:
        connection.exec_driver_sql("CREATE TABLE things (name TEXT PRIMARY KEY)")
    yield engine
    engine.dispose()


def pool_of(engine: sa.Engine) -> LendingPool:
    assert isinstance(engine.pool, LendingPool)
    return engine.pool


def test_a_connection_is_lent_again_and_its_settings_hold(engine: sa.Engine) -> None:
    with pool_of(engine).lent() as (first, _):
        assert first.execute("PRAGMA synchronous").fetchone() == (2,)
        assert first.execute("PRAGMA foreign_keys").fetchone() == (1,)
    with pool_of(engine).lent() as (second, _):
        assert second is first
    with engine.connect() as connection:
        assert connection.connection.driver_connection is first


@pytest.mark.parametrize("fails", [False, True])
def test_what_was_not_ended_is_undone_and_holds_nobody_up(engine: sa.Engine, fails: bool) -> None:
    try:
        with pool_of(engine).lent() as (first, _):
            first.execute("BEGIN IMMEDIATE")
            first.execute("INSERT INTO things VALUES ('one')")
            if fails:
                raise KeyError
    except KeyError:
        pass
    with pool_of(engine).lent() as (second, _):
        assert second is not first
        assert second.execute("SELECT name FROM things").fetchall() == []
    with engine.begin() as connection:
        connection.exec_driver_sql("INSERT INTO things VALUES ('two')")


def test_a_connection_that_is_given_up_is_made_anew(engine: sa.Engine) -> None:
    with pool_of(engine).lent() as (first, entry):
        entry.invalidate()
    with pytest.raises(DRIVER.ProgrammingError):
        first.execute("SELECT 1")
    with pool_of(engine).lent() as (second, _):
        assert second.execute("PRAGMA synchronous").fetchone() == (2,)


def test_others_wait_while_it_is_lent(engine: sa.Engine) -> None:
    pool_of(engine)._timeout = 0.05
    with pool_of(engine).lent(), pytest.raises(sa.exc.TimeoutError):
        engine.connect()
    engine.connect().close()
