"""Shared by all tests: shapes in core's signatures are checked while tests run, and where the real data lies."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from jaxtyping import install_import_hook

# Before any import of core: annotations such as Float[np.ndarray, "n 3"] become run-time checks.
# The numeric tower: an int is a fine float, as everywhere in Python.
install_import_hook("core", "beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))")

# Deadlines would make the suite depend on the machine's speed; the seed is fixed so that a failure repeats.
settings.register_profile(
    "gridpose", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("gridpose")


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Real photographs and published measurements, which are not part of the project."""
    default = Path(__file__).parent.parent.parent / "shared" / "data"
    folder = Path(os.environ.get("GRIDPOSE_TEST_DATA", default))
    if not folder.is_dir():
        pytest.skip("the real photographs are not here: set GRIDPOSE_TEST_DATA to their folder")
    return folder


@pytest.fixture
def postgres_url() -> Iterator[str]:
    """The address of an empty PostgreSQL database of this test's own, dropped afterwards.

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
    with connection:
        connection.execute(f"CREATE DATABASE {name}")
        yield server.rpartition("/")[0].replace("postgresql://", "postgresql+psycopg://") + f"/{name}"
        connection.execute(f"DROP DATABASE {name} WITH (FORCE)")
