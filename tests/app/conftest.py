"""A real application on a data folder of its own, and the images that tests send to it."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from app.services.installation.context import ServiceContext
from app.settings import Settings
from core.simulation.renderer import render
from core.targets.specification import TargetSpec
from tests.support.environment.postgres import EITHER_DATABASE, new_database
from tests.support.image.images import encode
from tests.support.service.applications import empty_data_dir, open_api, serve_api, side_processes
from tests.support.service.service import Api, ApiMaker
from tests.support.simulation.scenes import standard_scene

__all__ = ["empty_data_dir", "open_api", "serve_api", "side_processes"]  # fixtures


@pytest.fixture
def api(open_api: ApiMaker) -> Iterator[Api]:
    """An application that takes uploads and computes nothing."""
    with open_api() as running:
        yield running


@pytest.fixture(scope="session")
def migrated_postgres(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, str]]:
    """A data folder and its PostgreSQL database as the first start leaves them, to be copied."""
    folder = tmp_path_factory.mktemp("migrated") / "data"
    with new_database() as url:
        ServiceContext.open(Settings(data_dir=folder, database_url=url, workers=0)).close()
        yield folder, url


@pytest.fixture(params=EITHER_DATABASE)
def any_api(request: pytest.FixtureRequest, open_api: ApiMaker, tmp_path: Path) -> Iterator[Api]:
    """The same, once on SQLite and, in the larger tier, once on PostgreSQL."""
    if request.param == "sqlite":
        with open_api() as running:
            yield running
    else:
        folder, template = request.getfixturevalue("migrated_postgres")
        shutil.copytree(folder, tmp_path / "data")
        with new_database(template) as url, open_api(tmp_path / "data", database_url=url) as running:
            yield running


@pytest.fixture(scope="module")
def computing_api(open_api: ApiMaker) -> Iterator[Api]:
    """An application with one worker process."""
    with open_api(workers=1, lent_workers=True) as running:
        yield running


@pytest.fixture(scope="session")
def board_png() -> bytes:
    """A rendered image of the target."""
    target = TargetSpec("chessboard", 9, 6, 25.0)
    return encode(".png", render(standard_scene(target, seed=1, tilt=math.radians(30.0), clutter=0.0)))


@pytest.fixture(scope="session")
def grey_png() -> bytes:
    """A small image of nothing."""
    return encode(".png", np.full((48, 64), 128, np.uint8))
