"""`gridpose report list` takes the session as other lists do."""

from __future__ import annotations

from typing import Any

from tests.support.command_line import gridpose


def test_the_session_is_an_argument_or_an_option(served: Any) -> None:
    served.make_session(name="listed")
    gridpose(served, "report", "list", "listed")
    gridpose(served, "report", "list", "--session", "listed")
    gridpose(served, "report", "list", "none", code=1)
    gridpose(served, "report", "list", "listed", "--session", "listed", code=2)
