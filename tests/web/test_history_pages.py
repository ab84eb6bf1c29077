"""A robot's history and the comparison of two reports in a real browser: seen, used, readable for everybody."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from app.analyses.history import summarise_reports
from tests.support.service.service import ApiMaker
from tests.support.sessions.filed_reports import content, store_filed
from tests.web.conftest import HOSTILE, Cell, is_too_wide, new_key, show, violations

pytestmark = pytest.mark.slow
SESSIONS, CHANGE_AT = 24, 15


@pytest.fixture(scope="module")
def cell(serve_api: ApiMaker) -> Iterator[Cell]:
    """A service with a robot whose repeatability grew by a third, a belt having been replaced just before."""
    with serve_api() as api:
        found = Cell(api, [])
        joint = {"a_mm": 180.0, "alpha_deg": -90.0, "d_mm": 400.0, "theta_offset_deg": 0.0}
        robot = api.client.post("/v1/robots", json={"name": "KR 5 arc", "joints": [joint] * 6})
        found.robot_id = robot.json()["id"]
        rng = np.random.default_rng(3)
        sizes = 0.05 * np.exp(rng.normal(0.0, 0.05, SESSIONS))
        sizes[CHANGE_AT:] *= 1.35
        store_filed(
            api,
            [
                content(k, robot=found.robot_id, rp_mm=float(size), name=HOSTILE if k == 3 else f"Week {k}")
                for k, size in enumerate(sizes, start=1)
            ],
        )
        store_filed(api, [content(90, robot=found.robot_id, conditions={"load_kg": 1.0}, name="Half load")])
        while summarise_reports(api.installation.database):
            pass
        event = {"at": "2020-01-16T08:00:00Z", "note": "Belt of joint 5 replaced"}
        assert api.client.post(f"/v1/robots/{found.robot_id}/events", json=event).status_code == 201
        yield found


def test_a_robots_history_shows_charts_change_and_events(cell: Cell, open_page: Callable[..., Any]) -> None:
    page = open_page(f"/ui/robots/{cell.robot_id}")
    page.click("text=Control charts, what changed, events")
    page.wait_for_url("**/history")
    page.locator("figure img").scroll_into_view_if_needed()
    page.wait_for_selector("figure img")
    page.evaluate("document.querySelector('figure img').decode()")
    assert "went up" in page.inner_text("section.decision")
    assert "Belt of joint 5 replaced" in page.inner_text("section.decision")
    assert page.locator("section h2:has-text('comparable session')").count() == 2
    page.click("summary >> nth=0")
    assert page.locator("details >> nth=0").locator("tbody tr").count() == SESSIONS
    assert page.get_attribute("figure img", "src").endswith("axis=date")
    page.click("nav.filters >> text=By session")
    page.wait_for_selector("figure img[src$='axis=session']")
    page.fill("#at", "2020-02-01T10:00")
    page.fill("#note", "Gearbox of joint 2")
    page.check("[name=restarts_charts]")
    page.click("button:has-text('Note')")
    page.wait_for_selector("td:has-text('begin anew')")
    (one,) = [
        event
        for event in cell.api.client.get(f"/v1/robots/{cell.robot_id}/events").json()["items"]
        if event["note"] == "Gearbox of joint 2"
    ]
    assert one["restarts_charts"]
    page.on("dialog", lambda dialog: dialog.accept())
    page.click("[aria-label='Delete Gearbox of joint 2']")
    page.wait_for_selector("td:has-text('begin anew')", state="detached")
    page.click("nav.filters >> text=Kinematics")
    page.wait_for_selector("text=No report of a session of this robot is on kinematics.")
    assert not page.troubles


def test_plots_on_a_phone_keep_their_size_and_move_in_their_box(
    cell: Cell, open_page: Callable[..., Any]
) -> None:
    page = open_page(f"/ui/robots/{cell.robot_id}/history", None, viewport={"width": 360, "height": 740})
    page.locator("figure img").scroll_into_view_if_needed()
    page.wait_for_selector("figure.paper[tabindex='0']")
    drawn, box = (
        page.evaluate(f"document.querySelector('{one}').getBoundingClientRect().width")
        for one in ("figure img", "figure.paper")
    )
    assert drawn >= 700.0, "small type of 8 points stays readable"
    assert box <= 360.0
    page.focus("figure.paper")
    page.keyboard.press("ArrowRight")
    page.wait_for_function("document.querySelector('figure.paper').scrollLeft > 0")  # it scrolls smoothly
    assert not is_too_wide(page)
    assert not page.troubles


def test_two_reports_are_compared_from_the_list(cell: Cell, open_page: Callable[..., Any]) -> None:
    page = open_page("/ui/reports")
    page.locator("[name=report]").nth(0).check()
    page.locator("[name=report]").nth(1).check()
    page.click("text=Compare the two that are ticked")
    page.wait_for_url("**/ui/reports/comparison?*")
    assert "Not comparable" in page.inner_text("h2")
    assert "load" in page.inner_text("section.decision")
    page.goto("/ui/reports")
    page.click("text=Compare the two that are ticked")
    page.wait_for_selector("text=Two reports are compared, and none is ticked")
    ids = [f"rep_{k:026d}" for k in (1, SESSIONS)]
    page.goto(f"/ui/reports/comparison?report={ids[1]}&report={ids[0]}")
    assert page.locator("tbody tr").count() == 3
    page.goto(f"/ui/reports/comparison?report={ids[0]}&report=rep_{'1' * 26}")
    assert "no such report" in page.inner_text("main")


def test_ticks_stay_while_the_list_of_reports_is_renewed(cell: Cell, open_page: Callable[..., Any]) -> None:
    page = open_page("/ui/reports")
    page.locator("[name=report]").nth(1).check()
    page.evaluate(
        """() => {
          document.getElementById("reports").dataset.former = "yes";
          return htmx.ajax("GET", "/ui/reports", { target: "#reports", select: "#reports", swap: "outerHTML" });
        }"""
    )
    page.wait_for_selector("#reports:not([data-former])")
    assert page.locator("[name=report]").nth(1).is_checked()
    assert page.locator("[name=report]:checked").count() == 1
    assert not page.troubles


def test_a_kind_of_figures_that_there_is_not_is_said(cell: Cell, open_page: Callable[..., Any]) -> None:
    page = open_page()
    assert page.goto(f"/ui/robots/{cell.robot_id}/history?kind=speed").status == 422
    assert "There is no kind of figures “speed”." in page.inner_text("main")
    assert "repeatability" in page.inner_text("main")


def test_a_reader_sees_no_form_and_a_stranger_no_robot(cell: Cell, open_page: Callable[..., Any]) -> None:
    page = open_page(f"/ui/robots/{cell.robot_id}/history", new_key(cell, "read"))
    assert page.locator("form[data-action]").count() == 0
    other = cell.api.make_session()
    key = cell.api.key("read", session_ids=[other])["Authorization"].removeprefix("Bearer ")
    page = open_page(f"/ui/robots/{cell.robot_id}/history", key)
    assert "no such robot" in page.inner_text("main")


def test_the_pages_are_readable_for_everybody(cell: Cell, open_page: Callable[..., Any]) -> None:
    first, last = (f"rep_{k:026d}" for k in (1, SESSIONS))
    page = open_page()
    for path in (
        f"/ui/robots/{cell.robot_id}/history",
        f"/ui/reports/comparison?report={first}&report={last}",
        "/ui/reports",
    ):
        show(page, 360)
        page.goto(path)
        page.evaluate(
            "Promise.all([...document.images].map((one) => { one.loading = 'eager'; return one.decode(); }))"
        )
        for width in (360, 1280):
            show(page, width)
            assert violations(page) == [], (path, width)
            assert not is_too_wide(page), (path, width)
    assert not page.troubles
