"""One service for all tests of a module."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.support.service.service import ApiMaker


@pytest.fixture(scope="module")
def served(serve_api: ApiMaker) -> Iterator[Any]:
    with serve_api() as api:
        yield api
