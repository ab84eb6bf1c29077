"""Plans in a real browser: parts that are computed when they are opened, and a form without a script; and forms that
state what was measured of a target, and change a session.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tests.web.conftest import Cell

pytestmark = pytest.mark.slow
Open = Callable[..., Any]


def test_next_views_come_when_they_are_opened(cell: Cell, open_page: Open) -> None:
    page = open_page(f"/ui/sessions/{cell.session_id}")
    assert page.locator("#next-view table").count() == 0
    page.locator("summary", has_text="Next views").press("Enter")
    page.wait_for_selector("#next-view table, #next-view .refusal", timeout=120_000)
    assert "px" in page.inner_text("#next-view")
    assert not page.troubles


def test_a_cube_is_planned_by_its_form(cell: Cell, open_page: Open) -> None:
    page = open_page("/ui/sessions/new")
    page.click("text=Plan one")
    page.fill("#side", "100")
    page.fill("#centre", "900, 0, 450")
    page.click("button:has-text('Plan')")
    page.wait_for_selector("#forecast", timeout=120_000)
    with page.expect_download() as saved:
        page.click("text=Check list, PDF")
    assert saved.value.suggested_filename == "iso9283.pdf"
    assert saved.value.path().read_bytes().startswith(b"%PDF-")
    assert not page.troubles


def test_a_sheet_that_was_measured_and_a_session_with_another_target_are_stated(
    cell: Cell, open_page: Open
) -> None:
    target = cell.api.make_target(columns=8, rows=5)
    page = open_page(f"/ui/targets/{target}")
    page.click("summary:has-text('State what was measured')")
    for field, value in (("c-x", "25,003"), ("c-ux", "0.002"), ("c-y", "24.998"), ("c-uy", "0.002")):
        page.fill(f"#{field}", value)
    page.click("text=State it")
    page.wait_for_selector("h2:has-text('Measured')")
    stated = cell.api.client.get(f"/v1/targets/{target}").json()["certificate"]
    assert (stated["pitch_x_mm"], stated["pitch_y_mm"], stated["number"]) == (25.003, 24.998, None)
    session_id = cell.api.make_session(cell.target_id, name="Wrong board")
    page.goto(f"/ui/sessions/{session_id}")
    page.click("text=Change name, target or robot")
    page.fill("#name", "Right board")
    page.uncheck(f"[value={cell.target_id}]")
    page.check(f"[value={target}]")
    page.click("button:has-text('Change')")
    page.wait_for_url(f"**/ui/sessions/{session_id}")
    changed = cell.api.client.get(f"/v1/sessions/{session_id}").json()
    assert (changed["name"], changed["target_ids"]) == ("Right board", [target])
    assert not page.troubles
