"""A session that is watched by its name, and is deleted: another one takes its place."""

from __future__ import annotations

from typing import Any

import pytest

from app.client.watch import CannotBegin
from tests.support.image.images import small_image
from tests.support.service.service import wait_until
from tests.support.service.watched import WatchedCell


@pytest.fixture
def cell(cell: WatchedCell, request: pytest.FixtureRequest) -> WatchedCell:
    """A cell whose session has the test's name."""
    cell.direct.change(f"/v1/sessions/{cell.session_id}", {"name": request.node.name})
    return cell


def named(cell: WatchedCell, name: str) -> str | None:
    """Return the id of the session with this name, if there is one, and let the cell look at it."""
    found = list(cell.direct.items("/v1/sessions", name=name))
    if found:
        cell.session_id = found[0]["id"]
    return cell.session_id if found else None


def target_of(cell: WatchedCell) -> str:
    return str(cell.direct.get(f"/v1/sessions/{cell.session_id}")["target_ids"][0])


def test_a_deleted_session_is_made_again_by_its_name_while_watching(
    cell: WatchedCell, request: pytest.FixtureRequest
) -> None:
    name = request.node.name
    first = cell.session_id
    cell.write("P1/1.png", small_image(1))
    cell.write("poses.csv", b"pose_id,x_mm,y_mm,z_mm\nP1,1,2,3\n")
    with cell.watching(session=name, target=target_of(cell)):
        wait_until(lambda: cell.has(1), 120)
        cell.direct.delete(f"/v1/sessions/{first}")
        cell.write("P1/2.png", small_image(2))
        wait_until(lambda: named(cell, name) not in (None, first) and cell.has(2), 120)
        pose = f"/v1/sessions/{cell.session_id}/poses/P1"
        wait_until(lambda: cell.direct.get(pose)["position_mm"] is not None, 120)
    assert sum(f"no longer has session {first}" in line for line in cell.lines) == 1, cell.lines
    assert not any("refuses" in line for line in cell.lines)
    stored = len(cell.lines)
    assert cell.watch(session=name).stored == 0, "a further run finds the same session"
    assert not any("no longer" in line for line in cell.lines[stored:])


def test_a_session_that_was_deleted_between_runs_is_found_by_its_name(
    cell: WatchedCell, request: pytest.FixtureRequest
) -> None:
    name: Any = request.node.name
    first, target = cell.session_id, target_of(cell)
    cell.write("P1/1.png", small_image(1))
    assert cell.watch(session=name).session_id == first
    cell.direct.delete(f"/v1/sessions/{first}")
    with pytest.raises(CannotBegin, match="session_not_found"):
        cell.watch(session=name)
    with cell.watching(session=name):
        wait_until(lambda: any("No session has" in line for line in cell.lines), 120)
        cell.direct.create("/v1/sessions", {"name": name, "target_ids": [target]})
        wait_until(lambda: named(cell, name) is not None and cell.has(1), 120)
    assert cell.session_id != first


def test_a_deleted_session_that_was_given_by_its_id_is_refused(cell: WatchedCell) -> None:
    cell.write("P1/1.png", small_image(1))
    assert cell.watch().stored == 1
    cell.direct.delete(f"/v1/sessions/{cell.session_id}")
    assert cell.watch(give_up_s=0.3).gave_up
    assert any("refuses key or session" in line for line in cell.lines)
