"""One application for all tests of a module."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support.service.service import Api, ApiMaker


@pytest.fixture(scope="module")
def api(open_api: ApiMaker) -> Iterator[Api]:
    """One application for all tests here: none counts what is stored."""
    with open_api() as running:
        yield running
