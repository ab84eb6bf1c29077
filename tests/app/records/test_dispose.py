"""A database that is closed leaves no connection open."""

from __future__ import annotations

import sqlalchemy as sa

from app.records.database import Database


def test_a_connection_that_a_thread_still_uses_is_closed_when_given_back(postgres_url: str) -> None:
    database = Database(postgres_url)
    with database.read() as records:
        records.execute(sa.select(1))
        driver = records.connection().connection.driver_connection
        database.dispose()
        assert driver is not None
        assert not driver.closed
    assert driver.closed
