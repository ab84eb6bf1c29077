"""Plans in a real browser: parts that are computed when they are opened, and a form without a script; and forms that
state what was measured of a target, change a session, and load its commanded poses.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.web.conftest import Cell, is_too_wide, new_key, violations

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


def test_a_plan_that_is_refused_keeps_what_was_typed(cell: Cell, open_page: Open) -> None:
    page = open_page()
    page.goto(f"/ui/plans/iso9283?target={cell.target_id}&centre_mm=900")
    described = page.get_attribute("#centre", "aria-describedby")
    assert page.inner_text(f"#{described}") == "Centre x, y, z, mm: is not three numbers"
    assert "Write three numbers" in page.inner_text("form > .refusal")
    assert page.evaluate("document.activeElement.id") == "centre"
    assert page.input_value("#centre") == "900"
    assert violations(page) == []
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
    stated |= {"temperature_c": 20.0, "expansion_per_k": 8.5e-6}
    cell.api.client.patch(f"/v1/targets/{target}", json={"certificate": stated})
    page.reload()
    page.click("summary:has-text('Correct what was measured')")
    assert page.input_value("#c-y") == "24.998"
    page.fill("#c-ux", "3")
    page.click("text=Correct it")
    page.wait_for_selector(".refusal, .field-problem")
    assert "would be 0.003 mm if it was stated in micrometres" in page.inner_text("main form")
    page.fill("#c-ux", "0.003")
    page.click("text=Correct it")
    page.wait_for_selector("text=25.0030 ± 0.0030 mm along x")
    corrected = cell.api.client.get(f"/v1/targets/{target}").json()["certificate"]
    assert corrected == stated | {
        "standard_uncertainty": stated["standard_uncertainty"] | {"pitch_x_mm": 0.003}
    }
    page.troubles.clear()  # the refusal, which the console names as well
    session_id = cell.api.make_session(cell.target_id, name="Wrong board")
    page.goto(f"/ui/sessions/{session_id}")
    page.click("text=Change name, target, camera mount")
    page.fill("#name", "Right board")
    page.uncheck(f"[value={cell.target_id}]")
    page.check(f"[value={target}]")
    page.click("button:has-text('Change')")
    page.wait_for_url(f"**/ui/sessions/{session_id}")
    changed = cell.api.client.get(f"/v1/sessions/{session_id}").json()
    assert (changed["name"], changed["target_ids"]) == ("Right board", [target])
    assert not page.troubles


def test_commanded_poses_are_shown_before_they_are_stored_and_refused_by_line(
    cell: Cell, open_page: Open, tmp_path: Path
) -> None:
    session_id = cell.api.make_session(cell.target_id, name="Commanded")
    page = open_page(f"/ui/sessions/{session_id}/poses", viewport={"width": 360, "height": 800})
    file = tmp_path / "poses.csv"

    def choose(text: str) -> None:
        file.write_text(text, encoding="utf-8")
        page.set_input_files("#table", file)

    choose("pose_id,x\nP1,900\n")
    page.wait_for_selector(".problem:has-text('no such column: x')")
    choose("pose_id,x_mm,y_mm,z_mm\nP1,900,0\nP2,1,2,high\n")
    page.wait_for_selector("#problems")
    assert page.inner_text("#problems").splitlines() == [
        "Line 2: a coordinate is missing; fill x_mm, y_mm and z_mm, or none",
        "Line 3: z_mm is not a number: high",
    ]
    assert violations(page) == []
    assert page.is_disabled("#poses-form button")
    # A spreadsheet's: semicolons and decimal commas.
    choose("pose_id;x_mm;y_mm;z_mm;roll_deg;pitch_deg;yaw_deg;j1_deg\nP1;0,9;0;0,45;3,1416;0;0;400\n")
    page.wait_for_selector("#read-title:has-text('poses.csv: 1 pose was read')")
    assert page.inner_text("#read-rows tr").split("\t")[:3] == ["P1", "0.9", "0"]
    assert violations(page) == []
    assert not is_too_wide(page)
    choose("pose_id;x_mm;y_mm;z_mm\nP1;0,9;0;0,45\nP2;0,8;0,1;0,4\n")
    page.wait_for_selector("button:has-text('Store 2 poses')")
    page.click("#poses-form button")
    page.wait_for_selector("#poses-form .refusal:has-text('look like metres')")
    refusal = page.inner_text("#poses-form .refusal")
    assert "tick the box" in refusal
    assert "Line 2, position: 0.9 mm would be 900 mm if it was stated in metres" in refusal
    assert not cell.api.client.get(f"/v1/sessions/{session_id}/poses").json()["items"]
    page.troubles.clear()  # the browser logs the refusal that was asked for
    page.check("[name=accept]")
    page.click("#poses-form button")
    page.wait_for_selector("td:has-text('0.9, 0, 0.45')")
    stored = cell.api.client.get(f"/v1/sessions/{session_id}/poses").json()["items"]
    assert [one["position_mm"] for one in stored] == [[0.9, 0.0, 0.45], [0.8, 0.1, 0.4]]
    # The table that the page gives is one that it takes.
    with page.expect_download() as saved:
        page.click("text=Download this session's poses to fill in")
    table = saved.value.path().read_text(encoding="utf-8")
    choose(table.replace("0.9,0.0,0.45,,,", "900,0,450,180,0,0"))
    page.wait_for_selector("button:has-text('Store 2 poses')")
    page.click("#poses-form button")
    page.wait_for_selector("td:has-text('900, 0, 450')")
    assert page.inner_text("tbody tr:first-child td >> nth=1") == "180, 0, 0"
    assert violations(page) == []
    assert not is_too_wide(page)
    assert not page.troubles
    # Without the token of the page nothing is stored; a key that only reads sees no form.
    answer = page.evaluate(
        "(address) => fetch(address, {method: 'POST', body: '[]', headers: {'Content-Type': 'application/json'}})"
        ".then((one) => one.status)",
        f"/v1/sessions/{session_id}/poses",
    )
    assert answer == 403
    page = open_page(f"/ui/sessions/{session_id}/poses", new_key(cell, "read"))
    assert page.locator("#load-poses").count() == 0
    assert page.locator("tbody tr").count() == 2
