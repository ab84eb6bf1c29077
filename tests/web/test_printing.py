"""Pages on paper: every column of a table, every row, and ink that shows on white."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tests.web.conftest import HOSTILE, Cell

pytestmark = pytest.mark.slow
Open = Callable[..., Any]
A4_PX = 718
"""Width of A4 within the margins of Chromium, at 96 px an inch."""
CUT = """[...document.querySelectorAll(".scroll")].filter((one) => one.offsetParent &&
  (one.scrollWidth > one.clientWidth + 1 || one.scrollHeight > one.clientHeight + 1)).map((one) => one.ariaLabel)"""
INK = "getComputedStyle(document.body).color"
POINTS = """(() => { const canvas = document.querySelector("#scatter canvas");
  const seen = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  for (let k = 0; k < seen.length; k += 4)
    if (seen[k + 3] === 255 && seen[k] + seen[k + 1] + seen[k + 2] < 99) return true;
  return false; })()"""


def test_a_table_on_paper_is_whole_and_dark_on_white(cell: Cell, open_page: Open) -> None:
    """Of a reader who looks at dark pages, by the system's setting and by the button."""
    page = open_page(
        f"/ui/sessions/{cell.session_id}/repeatability",
        viewport={"width": A4_PX, "height": 1000},
        color_scheme="dark",
    )
    page.wait_for_selector("#scatter:not([hidden])")
    assert not page.evaluate(POINTS)
    for theme in ("", "dark"):
        page.evaluate("(theme) => theme && (document.documentElement.dataset.theme = theme)", theme)
        page.emulate_media(media="print", color_scheme="dark")
        page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        assert page.evaluate(POINTS), theme
        assert page.evaluate(INK) == "rgb(24, 32, 42)"
        assert page.evaluate(CUT) == []
        page.emulate_media(media="screen", color_scheme="dark")
        assert page.evaluate(INK) == "rgb(231, 237, 244)"
    assert not page.troubles


def test_long_lists_are_printed_whole(cell: Cell, open_page: Open) -> None:
    for number in range(12):
        cell.api.make_session(cell.target_id, name=f"{HOSTILE} {number}", robot_id=cell.robot_id)
    for path in ("/ui/", "/ui/system"):
        page = open_page(path, viewport={"width": A4_PX, "height": 1000})
        page.emulate_media(media="print")
        assert page.evaluate(CUT) == []
        assert not page.troubles
