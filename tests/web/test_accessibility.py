"""Pages as everybody reads them: accessible, no wider than the screen, and without scripts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tests.support.service.service import wait_until
from tests.web.conftest import HANGS_MS, HOSTILE, Cell, is_too_wide, show, violations

pytestmark = pytest.mark.slow
Open = Callable[..., Any]
TABS = ("repeatability", "camera", "upload", "poses", "reports", "next-view", "error-map", "joint-noise")


def made_report(cell: Cell) -> str:
    """Order a report of the session's camera and wait until it is made."""
    ordered = cell.api.client.post(f"/v1/sessions/{cell.session_id}/reports", json={"kind": "camera"}).json()
    address = f"/v1/reports/{ordered['id']}"
    wait_until(
        lambda: cell.api.client.get(address).json()["status"] == "succeeded", 120.0, "the report is made"
    )
    return str(ordered["id"])


SCREENS = ((360, "light"), (1280, "dark"), (3840, "light"))


def test_every_page_is_accessible_and_no_wider_than_the_screen(cell: Cell, open_page: Open) -> None:
    """A page is laid out anew, by the same rules and scripts, when its window is resized: each is opened once."""
    hostile = cell.api.make_session(cell.target_id, name=HOSTILE[:200], robot_id=cell.robot_id)
    report = made_report(cell)
    pages = [
        *("/ui/", f"/ui/sessions/{cell.session_id}", f"/ui/sessions/{hostile}", "/ui/sessions/new"),
        *(f"/ui/measurements/{cell.measurement_ids[0]}", f"/ui/measurements/{cell.refused_id}"),
        *(f"/ui/sessions/{cell.session_id}/{tail}" for tail in TABS),
        *(
            "/ui/reports",
            f"/ui/reports/{report}",
            "/ui/robots",
            f"/ui/robots/{cell.robot_id}",
            f"/ui/robots/{cell.robot_id}/plan",
            f"/ui/plans/iso9283?target={cell.target_id}",
            "/ui/targets",
            f"/ui/targets/{cell.target_id}",
        ),
        *("/ui/targets/new", "/ui/keys", "/ui/audit", "/ui/system"),
    ]
    page = open_page()
    for path in pages:
        show(page, *SCREENS[0])
        page.goto(path, wait_until="domcontentloaded")
        page.wait_for_selector("#theme:not([hidden])")  # the page's script has run
        assert page.locator("h1").count() == 1, path
        for width, scheme in SCREENS:
            show(page, width, scheme)
            if width < 3840:  # width changes the layout alone
                assert violations(page) == [], (path, width)
            assert not is_too_wide(page), (path, width)
    assert not page.troubles


def test_a_table_wider_than_its_box_says_so_until_its_end_is_shown(cell: Cell, open_page: Open) -> None:
    page = open_page(viewport={"width": 390, "height": 900})
    page.goto(f"/ui/sessions/{cell.session_id}/repeatability")
    table = "[aria-label='Pose repeatability']"
    page.wait_for_selector(f"{table}.wide.more")
    said = f"getComputedStyle(document.querySelector(\"{table}\"), '::before').content"
    assert "More columns" in page.evaluate(said)
    page.evaluate(f'document.querySelector("{table}").scrollLeft = 10000')
    page.wait_for_selector(f"{table}.wide:not(.more)")
    page.set_viewport_size({"width": 1900, "height": 900})
    page.wait_for_selector(f"{table}:not(.wide):not(.more)")
    assert page.evaluate(said) == "none"
    assert not page.troubles


def test_pages_are_readable_without_scripts(cell: Cell, chromium: Any, open_page: Open) -> None:
    cookies = open_page().context.cookies()
    context = chromium.new_context(base_url=cell.url, java_script_enabled=False)
    context.set_default_timeout(HANGS_MS)
    context.add_cookies(cookies)
    page = context.new_page()
    page.goto(f"/ui/sessions/{cell.session_id}?state=failed")
    assert page.locator(".tile").count() == 1
    page.goto(f"/ui/sessions/{cell.session_id}/repeatability", wait_until="domcontentloaded")
    assert page.locator("table.iso tbody tr").count() == 2
    page.click("summary:has-text('1 pose without RP')")  # folded: it is no reason to look far for the scatter
    assert page.is_visible("td >> text=0")
    page.goto(f"/ui/measurements/{cell.refused_id}", wait_until="domcontentloaded")
    assert "What to do:" in page.inner_text("main")
    page.goto(f"/ui/measurements/{cell.measurement_ids[0]}", wait_until="domcontentloaded")
    assert not page.is_visible("text=The image is loading")
    context.close()
