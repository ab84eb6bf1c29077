"""A folder that is watched, and the service its images go to."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.service.service import Api, ApiMaker
from tests.support.service.watched import WatchedCell


@pytest.fixture(scope="module")
def api(serve_api: ApiMaker) -> Iterator[Api]:
    """A service that takes images and computes nothing."""
    with serve_api() as running:
        yield running


@pytest.fixture
def cell(api: Api, tmp_path: Path) -> Iterator[WatchedCell]:
    with WatchedCell.of(api, tmp_path) as made:
        yield made
