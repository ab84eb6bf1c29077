"""Installations of several machines: a PostgreSQL database and a bucket, and services and workers that share them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.environment.object_store import ObjectStore, object_store
from tests.support.environment.postgres import new_database

PEPPER = "0" * 64


@pytest.fixture(scope="package")
def store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ObjectStore]:
    """A real S3 server."""
    with object_store(tmp_path_factory.mktemp("objects")) as running:
        yield running


@pytest.fixture
def environment(store: ObjectStore) -> Iterator[dict[str, str]]:
    """What every machine of a new installation has in its environment."""
    with new_database() as url:
        yield {
            **store.environment(),
            "GRIDPOSE_DATABASE_URL": url,
            "GRIDPOSE_BLOB_URL": f"s3://{store.new_bucket()}/installation",
            "GRIDPOSE_KEY_PEPPER": PEPPER,
            "GRIDPOSE_DISK_FLOOR_BYTES": "0",
        }


@pytest.fixture
def set_environment(environment: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """The same, set in this process."""
    from app.blobs.objects import store_of

    store_of.cache_clear()
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    return environment


@pytest.fixture
def machine(tmp_path: Path) -> Path:
    """The data folder of one more machine."""
    return tmp_path / "machine"
