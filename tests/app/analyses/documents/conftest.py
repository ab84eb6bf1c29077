"""One session of which every analysis can be asked; analyses are kept, so that tests share them."""

from __future__ import annotations

from typing import Any

import pytest

from tests.support.sessions.robot_session import RobotSession, store_robot_session


@pytest.fixture(scope="session")
def robot_session(api: Any) -> RobotSession:
    """A robot before one board: see `store_robot_session`."""
    return store_robot_session(api)
