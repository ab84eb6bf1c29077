"""Fixtures of the jobs' tests."""

from __future__ import annotations

import os

import pytest

from tests.support.environment.processes import OwnWorkers, worker_processes


@pytest.fixture
def own_workers() -> OwnWorkers:
    """Return what gives the worker processes that this test started; applications shared by others keep theirs."""
    others = worker_processes(os.getpid())
    return lambda: worker_processes(os.getpid()) - others
