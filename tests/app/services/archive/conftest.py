"""An installation with a session, its archive, and empty installations."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from app.services.archive import archive_session
from app.services.installation.context import ServiceContext
from app.settings import Settings
from tests.support.service.archives import store
from tests.support.service.service import Api, ApiMaker


@pytest.fixture(scope="module")
def source(open_api: ApiMaker) -> Iterator[Api]:
    with open_api() as running:
        yield running


@pytest.fixture(scope="module")
def session_id(source: Api) -> str:
    return store(source)


@pytest.fixture(scope="module")
def archive(source: Api, session_id: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("archive") / "cell.tar.gz"
    archived = archive_session(source.installation, session_id, path)
    assert archived.bytes == path.stat().st_size
    return path


@pytest.fixture(scope="module")
def empty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data folder of an installation of nothing, to be copied."""
    folder = tmp_path_factory.mktemp("empty") / "data"
    ServiceContext.open(Settings(data_dir=folder, workers=0)).close()
    return folder


@pytest.fixture
def other(empty: Path, tmp_path: Path) -> Iterator[ServiceContext]:
    shutil.copytree(empty, tmp_path / "other")
    opened = ServiceContext.open(Settings(data_dir=tmp_path / "other", workers=0))
    yield opened
    opened.close()
