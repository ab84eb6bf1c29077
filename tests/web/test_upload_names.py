"""Poses and cycles that the page of uploads reads from the names of files: those of `gridpose upload`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from app.client.images.files import plan_files
from tests.web.conftest import Cell, nothing

pytestmark = pytest.mark.slow
Open = Callable[..., Any]

NAMED = (
    "P1/IMG_0001.png",
    "P2/IMG_0001.png",
    "P3/front-c7.png",
    "P3/c3-b2.png",
    "P3/0004.png",
    "P3/c10b3.png",
)
NAMED += ("P4_0003.png", "P4-c4.png", "P4_5-b2.png", "P5-3.png", "Größe 1/1.png", "łódź/cycle_2.png")
REFUSED = ("Groesse-1/1.png", "שלום/1.png", "P6/0.png")
"""Two names that would be one pose, one of which nothing is legal, and a cycle of number 0."""


def test_a_folder_has_the_poses_that_the_command_gives_it(
    cell: Cell, open_page: Open, tmp_path: Path
) -> None:
    for at, name in enumerate((*NAMED, *REFUSED)):
        path = tmp_path / "images" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(nothing(200 + at))
    given = plan_files(tmp_path / "images")
    assert len(given.images) == len(NAMED)
    session_id = cell.api.make_session(cell.target_id, name="Named by folders")
    page = open_page(f"/ui/sessions/{session_id}/upload")
    page.set_input_files("#folder", tmp_path / "images")
    page.wait_for_selector("#plan:not([hidden])")
    odd = [row.split("\t") for row in page.inner_text("#rows").splitlines()[: len(REFUSED)]]
    assert {row[0].removeprefix("images/") for row in odd} == {one.name for one in given.skipped}
    page.click("#send")
    page.wait_for_selector(f"#report:has-text('{len(NAMED)} sent')")
    kept = cell.api.client.get(f"/v1/sessions/{session_id}/measurements", params={"limit": 50}).json()
    tags = [(one["pose_id"], one["cycle"], one["burst"], one["pose_label"]) for one in kept["items"]]
    assert sorted(tags, key=str) == sorted(
        ((one.pose_id, one.cycle, one.burst or 1, one.label) for one in given.images), key=str
    )
    assert not page.troubles


def test_several_folders_are_several_poses(cell: Cell, open_page: Open, tmp_path: Path) -> None:
    """Chosen one after the other, none of them is the folder that holds the poses."""
    page = open_page(f"/ui/sessions/{cell.session_id}/upload")
    for pose in ("P1", "P2"):
        (tmp_path / pose).mkdir()
        (tmp_path / pose / "IMG_0001.png").write_bytes(nothing(300))
        page.set_input_files("#folder", tmp_path / pose)
    page.wait_for_selector("#plan-title:has-text('2 images at 2 poses')")
    rows = [row.split("\t")[:3] for row in page.inner_text("#rows").splitlines()]
    assert rows == [["P1/IMG_0001.png", "P1", "–"], ["P2/IMG_0001.png", "P2", "–"]]
    assert not page.troubles


def test_cycles_that_are_counted_go_on_after_those_of_the_session(
    cell: Cell, open_page: Open, tmp_path: Path
) -> None:
    session_id = cell.api.make_session(cell.target_id, name="Two visits")

    def send(name: str, *numbers: int) -> Any:
        folder = tmp_path / name
        folder.mkdir(exist_ok=True)
        for at in numbers:
            (folder / f"{at:03}.png").write_bytes(nothing(500 + at))
        page = open_page(f"/ui/sessions/{session_id}/upload")
        page.set_input_files("#folder", folder)
        page.select_option("[name=pattern]", "one")
        hint = page.inner_text("#goes-on")
        page.click("#send")
        page.wait_for_selector("#report:has-text(' 0 to go.')")
        assert not page.troubles
        return hint

    def cycles() -> list[int]:
        return sorted(one["cycle"] for one in cell.api.measurements(session_id))

    assert send("morning", 1, 2) == ""
    assert cycles() == [1, 2]
    assert "The session has cycles of P1: the count goes on after them." in send("morning", 3, 4)
    assert cycles() == [1, 2, 3, 4]  # as an upload that was interrupted: two of the four were here
    send("evening", 5, 6)
    assert cycles() == [1, 2, 3, 4, 5, 6]
