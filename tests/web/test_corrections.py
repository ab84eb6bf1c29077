"""What an operator changes in a real browser, what pages say where it is refused, what another estimator changes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from app.web.routes import sessions
from app.web.words import ESTIMATORS
from tests.support.service.service import wait_until
from tests.web.conftest import Cell, nothing, violations

pytestmark = pytest.mark.slow
Open = Callable[..., Any]


def test_lens_and_conditions_are_stated_and_taken_back(cell: Cell, open_page: Open) -> None:
    session_id = cell.api.make_session(
        cell.target_id, name="Lens", conditions={"load_kg": 2.0, "notes": "warm"}
    )

    def stated() -> tuple[Any, Any]:
        found = cell.api.client.get(f"/v1/sessions/{session_id}").json()
        return found["lens"], {k: v for k, v in (found["conditions"] or {}).items() if v is not None}

    def change(**values: str) -> Any:
        page = open_page(f"/ui/sessions/{session_id}/change")
        for name, value in values.items():
            page.fill(f"#{name}", value)
        page.click("main form .primary")
        return page

    change(focal="8,5").wait_for_selector("#pixel[aria-invalid]")
    change(focal="8,5", pixel="3.45", load="2.5").wait_for_url(f"**/ui/sessions/{session_id}")
    lens = {"focal_length_mm": 8.5, "pixel_pitch_um": 3.45}
    assert stated() == (lens, {"load_kg": 2.5, "notes": "warm"})
    change(load="", notes="").wait_for_url(f"**/ui/sessions/{session_id}")
    assert stated() == (lens, {})
    change(focal="", pixel="").wait_for_url(f"**/ui/sessions/{session_id}")
    assert stated() == (None, {})


def test_selected_images_get_a_focus_group_and_are_computed_again(cell: Cell, open_page: Open) -> None:
    session_id = cell.api.make_session(cell.target_id, name="Two lenses")
    for image in cell.images[:2]:
        sent = cell.api.put_image(session_id, image.data, image.pose_id, cycle=image.cycle)
        cell.api.wait_for(sent.json()["id"])
    page = open_page(f"/ui/sessions/{session_id}")
    page.check("#select-all")
    assert page.inner_text("#selected") == "2 selected"
    page.click("[data-act=correct]")
    page.click("#correct-form .primary")
    page.wait_for_selector(
        "#correct-form .refusal:has-text('Enter a pose, a cycle, an image of the stop or a focus group.')"
    )
    page.fill("#new-group", "left")
    page.evaluate("document.getElementById('gallery').dataset.former = 'yes'")
    page.click("#correct-form .primary")
    page.wait_for_selector("#gallery:not([data-former])")  # the images as they are now
    first = cell.api.measurements(session_id)
    assert [one["focus_group"] for one in first] == ["left", "left"]
    page.check("#select-all")
    page.click("[data-act=retry]")
    earlier = {one["id"]: one["finished_at"] for one in first}
    wait_until(
        lambda: all(
            one["status"] == "succeeded" and one["finished_at"] > earlier[one["id"]]
            for one in cell.api.measurements(session_id)
        ),
        120.0,
        "both images are computed again",
    )
    page.wait_for_selector("text=2 measured")
    assert not page.troubles


def test_images_of_one_stop_are_numbered_on_the_pages(cell: Cell, open_page: Open) -> None:
    session_id = cell.api.make_session(cell.target_id, name="One stop")
    ids = [cell.api.put_image(session_id, nothing(400 + k), "P1", cycle=1).json()["id"] for k in (1, 2, 3)]
    for one in ids:
        cell.api.wait_for(one)
    page = open_page(f"/ui/sessions/{session_id}")
    page.check(f'[data-id="{ids[1]}"] .pick')
    page.click("[data-act=correct]")
    page.fill("#new-burst", "2")
    page.click("#correct-form .primary")
    page.wait_for_selector(".tile .name:has-text('image 2')")
    page.goto(f"/ui/measurements/{ids[2]}")
    page.fill("#c-burst", "3")
    page.click("form:has(#c-burst) button")
    page.wait_for_selector("h2:has-text('image 3')")
    assert sorted(one["burst"] for one in cell.api.measurements(session_id)) == [1, 2, 3]
    page.fill("#c-burst", "")
    page.click("form:has(#c-burst) button")
    page.wait_for_selector("h2:not(:has-text('image 3'))")
    assert sorted(one["burst"] for one in cell.api.measurements(session_id)) == [1, 1, 2]
    assert not page.troubles


def test_the_keyboard_stays_at_the_pages_of_images(
    cell: Cell, open_page: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sessions, "PAGE_SIZE", 9)  # 21 images: three pages
    page = open_page(f"/ui/sessions/{cell.session_id}")
    focused = "document.activeElement.rel || document.activeElement.id"
    for number, stays_at in ((2, "next"), (3, "gallery")):
        page.focus('#gallery .paging a[rel="next"]')
        page.keyboard.press("Enter")
        page.wait_for_selector(f".paging:has-text('page {number} of 3')")
        page.wait_for_function(f"({focused}) === '{stays_at}'")
    assert not page.troubles


def problems(page: Any) -> dict[str, str]:
    """Return the message next to each wrong field, by the field's id, as its description says it."""
    described = "one => [one.id, document.getElementById(one.getAttribute('aria-describedby')).innerText]"
    found = page.evaluate(f"[...document.querySelectorAll('[aria-invalid=true]')].map({described})")
    return dict(found)


def test_a_refused_session_keeps_what_was_typed_and_names_its_fields(cell: Cell, open_page: Open) -> None:
    page = open_page("/ui/sessions/new")
    page.fill("#name", "Refused first")
    page.fill("#temperature", "999")
    page.fill("#speed", "half")
    page.uncheck(f"[value={cell.target_id}]")
    page.click("main .primary")
    page.wait_for_selector("form > .refusal:has-text('Some fields are missing or not valid.')")
    assert "needs one at least" in page.inner_text("legend:has-text('Target') + .field-problem")
    assert page.get_attribute(f"[value={cell.target_id}]", "aria-invalid") == "true"
    assert page.evaluate("document.activeElement.name") == "target_ids"  # the first that is wrong
    shown = problems(page)
    assert shown["temperature"] == "Temperature, °C: must be at most 200"
    assert shown["speed"] == "Speed, %: must be a number"
    assert violations(page) == []
    page.check(f"[value={cell.target_id}]")
    page.fill("#temperature", "21,5")
    page.fill("#speed", "50")
    page.route("**/v1/sessions", lambda route: route.abort())
    page.click("main .primary")
    page.wait_for_selector("form > .refusal:has-text('The service cannot be reached.')")
    assert problems(page) == {}
    assert page.locator("form .refusal").count() == 1
    page.unroute("**/v1/sessions")
    page.troubles.clear()  # the browser logs both refusals
    page.click("main .primary")
    page.wait_for_url("**/upload")
    assert not page.troubles


def test_a_robot_in_metres_is_stored_after_a_tick(cell: Cell, open_page: Open) -> None:
    page = open_page("/ui/robots")
    page.fill("#name", "Micro arm")
    page.fill("#joints", "0.18, -90, 0.4, 0\n0.6, 0")
    page.click("main .primary")
    page.wait_for_selector(".field-problem:has-text('Line 2 is not: a, α, d, θ offset.')")
    assert page.locator("form > .refusal").count() == 0
    page.fill("#joints", "0.18, -90, 0.4, 0\n0.6, 0, 0\n0.12, 90, 0")
    page.click("main .primary")
    page.wait_for_selector("form > .refusal:has-text('tick the box')")
    assert sorted(page.locator(".field-problem").all_inner_texts()) == [
        f"joint {field}: {length} mm would be {1000 * length:g} mm if it was stated in metres"
        for field, length in (("1, a", 0.18), ("1, d", 0.4), ("2, a", 0.6), ("3, a", 0.12))
    ]
    page.troubles.clear()  # the browser logs the refusal that was asked for
    page.check("[data-accept] input")
    page.click("main .primary")
    page.wait_for_url("**/ui/robots/rob_*")
    assert not page.troubles


def test_another_estimator_says_what_changes_and_changes_the_table(cell: Cell, open_page: Open) -> None:
    page = open_page(f"/ui/sessions/{cell.session_id}/repeatability")
    pooled = page.inner_text("table.iso tbody tr:first-child")
    assert ESTIMATORS["pooled"][1] in page.inner_text("#estimator-form")
    page.select_option("[name=estimator]", "per_image")
    page.wait_for_url("**/repeatability?estimator=per_image*", timeout=120_000)
    assert ESTIMATORS["per_image"][1] in page.inner_text("#estimator-form")
    page.wait_for_selector("table.iso tbody tr")
    assert page.inner_text("table.iso tbody tr:first-child") != pooled
    assert not page.troubles
