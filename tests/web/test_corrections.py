"""What an operator changes of a session in a real browser, and what another estimator changes of its table."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from app.web.words import ESTIMATORS
from tests.support.service.service import wait_until
from tests.web.conftest import Cell

pytestmark = pytest.mark.slow
Open = Callable[..., Any]


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
    page.wait_for_selector("#correct-form .problem:has-text('Enter a pose, a cycle or a focus group.')")
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
        60.0,
        "both images are computed again",
    )
    page.wait_for_selector("text=2 measured")
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
