"""Databases of a test's own on the PostgreSQL server, dropped afterwards."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

EITHER_DATABASE = ["sqlite", pytest.param("postgresql", marks=[pytest.mark.postgres, pytest.mark.slow])]
"""Parameters of fixtures: whatever holds on SQLite holds on PostgreSQL, which the larger tier shows."""


@contextmanager
def new_database(template: str | None = None) -> Iterator[str]:
    """Make a database, empty or a copy of the one at the address `template`, and return its address.

    Skips where no server answers, unless one is required (`CI` or `GRIDPOSE_TEST_REQUIRE_POSTGRES`).
    """
    import psycopg

    server = os.environ.get("GRIDPOSE_TEST_POSTGRES_URL", "postgresql://postgres@127.0.0.1:5432/test")
    server = server.replace("postgresql+psycopg://", "postgresql://")
    try:
        connection = psycopg.connect(server, autocommit=True, connect_timeout=5)
    except psycopg.OperationalError as error:
        if os.environ.get("CI") or os.environ.get("GRIDPOSE_TEST_REQUIRE_POSTGRES"):
            pytest.fail(f"PostgreSQL is required here and does not answer: {error}")
        pytest.skip("no PostgreSQL server answers: set GRIDPOSE_TEST_POSTGRES_URL")
    name = f"gridpose_{uuid.uuid4().hex}"
    source = f" TEMPLATE {template.rpartition('/')[2]}" if template else ""
    with connection:
        connection.execute(f"CREATE DATABASE {name}{source}")
        try:
            yield server.rpartition("/")[0].replace("postgresql://", "postgresql+psycopg://") + f"/{name}"
        finally:
            connection.execute(f"DROP DATABASE {name} WITH (FORCE)")
