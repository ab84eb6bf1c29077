"""Fixtures of the analyses: one application for each module, and what stores measurements without computing them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.support.sessions.stored_sessions import Store, store_shots


@pytest.fixture(scope="session")
def api(open_api: Any) -> Iterator[Any]:
    """One application for all tests, each with sessions of its own: its process takes seconds to start."""
    with open_api() as running:
        yield running


@pytest.fixture
def store() -> Store:
    """Return a function that stores shots as finished measurements and returns their ids."""
    return store_shots
