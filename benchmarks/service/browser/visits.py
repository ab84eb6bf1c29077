"""Pages in Chromium: from the click until a page's scripts have run, and what the server took for it."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable
from pathlib import Path
from statistics import median
from typing import Any

from playwright.sync_api import sync_playwright

from app.cli.demo.service_process import ServiceProcess
from app.client import ServiceClient
from benchmarks.stored.analyses import stored_visits
from benchmarks.stored.visits import store
from benchmarks.table import Row

WITHIN_MS, FIRST_PAGE_MS, LARGE_SESSION_MS = 1000.0, 150.0, 300.0
BOARD = (9, 6)
SESSIONS = 30
"""In the list of the first page, in addition to the large one."""
_TIMES = """() => {
  const [page] = performance.getEntriesByType("navigation");
  return [page.domContentLoadedEventEnd, page.responseStart - page.requestStart];
}"""
"""All scripts are deferred: when their handlers have run, the page answers to its reader."""


def visit_rows(chromium: str, seeds: list[int], quick: bool) -> Iterable[Row]:
    """Measure the first page, and that of a large session."""
    repeats = 5 if quick else 21
    with (
        tempfile.TemporaryDirectory(prefix="gridpose-bench-") as name,
        sync_playwright() as playwright,
        ServiceProcess(Path(name), {"GRIDPOSE_WORKERS": "2"}) as service,
    ):
        assert service.admin_key is not None
        with ServiceClient(service.url, service.admin_key) as client:
            large = _sessions(client, Path(name), seeds[0])
        browser = launched(playwright, chromium)
        for what, path, within_ms in (
            ("first page", "/ui/", FIRST_PAGE_MS),
            ("session of 10,000 images", f"/ui/sessions/{large}", LARGE_SESSION_MS),
        ):
            visited = [_visit(browser, service.url, service.admin_key, path) for _ in range(repeats)]
            note = f"nothing kept by the browser; median of {repeats}, worst {max(one[0] for one in visited):.0f} ms"
            took = median(one[0] for one in visited)
            yield Row.at_most(f"{what}: until it answers to its reader", took, WITHIN_MS, "ms", note)
            server = median(one[1] for one in visited)
            yield Row.at_most(f"{what}: until the first byte", server, within_ms, "ms", "of the same visits")
        browser.close()


def launched(playwright: Any, chromium: str) -> Any:
    """Return a running Chromium."""
    flags = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
    return playwright.chromium.launch(executable_path=chromium, args=flags)


def signed_in_cookies(browser: Any, url: str, key: str) -> list[Any]:
    """Sign in; return what the browser keeps of it."""
    context = browser.new_context(base_url=url)
    page = context.new_page()
    page.goto("/ui/sign-in")
    page.fill("#key", key)
    page.press("#key", "Enter")
    page.wait_for_url("**/ui/")
    cookies: list[Any] = context.cookies()
    context.close()
    return cookies


def _visit(browser: Any, url: str, key: str, path: str) -> tuple[float, float]:
    """Open a page, signed in, with nothing kept; return ms until its scripts have run, and until the first byte."""
    cookies = signed_in_cookies(browser, url, key)
    context = browser.new_context(base_url=url, viewport={"width": 1280, "height": 900})
    context.add_cookies(cookies)
    page = context.new_page()
    page.goto(path, wait_until="domcontentloaded")
    page.wait_for_selector("#theme:not([hidden])")
    interactive, first_byte = page.evaluate(_TIMES)
    context.close()
    return float(interactive), float(first_byte)


def _sessions(client: ServiceClient, folder: Path, seed: int) -> str:
    """Make the sessions of the list, and one of 10,000 images; return the id of that."""
    target = {"name": "board", "kind": "chessboard", "columns": BOARD[0], "rows": BOARD[1], "pitch_mm": 10.0}
    target_id: str = client.create("/v1/targets", target)["id"]
    for number in range(SESSIONS):
        client.create("/v1/sessions", {"name": f"Cell {number}", "target_ids": [target_id]})
    large: str = client.create("/v1/sessions", {"name": "large", "target_ids": [target_id]})["id"]
    store(folder, large, target_id, stored_visits(BOARD, 50, seed))
    return large
