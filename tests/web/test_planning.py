"""Plans in a real browser: parts that are computed when they are opened, and a form without a script."""

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
