"""A real browser before a real service: Debian's Chromium, one for all tests of a module, and a small session.

Every page is watched: an error of a script or the console, and a request to another host, fail the test.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest

from tests.support.contract.cell import TARGET, CellImage, take_images
from tests.support.service.applications import empty_data_dir, serve_api, side_processes
from tests.support.service.service import Api, ApiMaker

__all__ = ["empty_data_dir", "serve_api", "side_processes"]  # fixtures
HOSTILE = "<script>alert(1)</script>שלום" + "Ω" * 160
"""A name that would run, reads from right to left in part, and would break a narrow page."""
TAGS = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]


@dataclass
class Cell:
    """What the service holds: a session of two poses with ten cycles each, and a robot with a data sheet."""

    api: Api
    images: list[CellImage]
    session_id: str = ""
    robot_id: str = ""
    target_id: str = ""
    measurement_ids: list[str] = field(default_factory=list)
    refused_id: str = ""

    @property
    def url(self) -> str:
        return str(self.api.client.base_url).rstrip("/")


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """The browser; without one the tests are skipped, but never under CI.

    One for each module: while Playwright is open, an event loop runs in this thread, and no test of another
    folder may come in between.
    """
    executable = os.environ.get("GRIDPOSE_TEST_CHROMIUM") or shutil.which("chromium")
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        executable = None
    if not executable:
        if os.environ.get("CI"):
            pytest.fail("Chromium is required here: apt-get install chromium")
        pytest.skip("no Chromium: apt-get install chromium, or set GRIDPOSE_TEST_CHROMIUM to it")
    with sync_playwright() as playwright:
        # As root, Chromium's sandbox cannot start.
        flags = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
        browser = playwright.chromium.launch(executable_path=executable, args=flags)
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def cell_images() -> list[CellImage]:
    """Two poses, ten cycles each."""
    return take_images(2, repeated=2, cycles=10)


@pytest.fixture(scope="module")
def cell(serve_api: ApiMaker, cell_images: list[CellImage]) -> Iterator[Cell]:
    """A service with one worker and a measured session; one of its images shows nothing."""
    with serve_api(workers=1, lent_workers=True) as api:
        found = Cell(api, cell_images)
        found.target_id = api.make_target(**TARGET)
        joint = {"a_mm": 180.0, "alpha_deg": -90.0, "d_mm": 400.0, "theta_offset_deg": 0.0}
        robot = {"name": "KR 5 arc", "joints": [joint] * 6, "datasheet_repeatability_mm": 0.2}
        found.robot_id = api.client.post("/v1/robots", json=robot).json()["id"]
        found.session_id = api.make_session(found.target_id, name="Cell 4, week 12", robot_id=found.robot_id)
        for image in cell_images:
            sent = api.put_image(
                found.session_id, image.data, image.pose_id, cycle=image.cycle, filename=image.filename
            )
            found.measurement_ids.append(sent.json()["id"])
        found.refused_id = api.put_image(found.session_id, nothing(0), "P9").json()["id"]
        for one in (*found.measurement_ids, found.refused_id):
            api.wait_for(one)
        yield found


def nothing(number: int) -> bytes:
    """An image without a target, another one for each number."""
    noise = np.random.default_rng(number).integers(100, 140, (96, 128), dtype=np.uint8)
    return bytes(cv2.imencode(".png", noise)[1])


HANGS_MS = 120_000
"""A page that takes longer hangs. How soon pages come is measured alone; here the process that computes may have to
start for one, alongside browsers and services of other tests."""


@pytest.fixture(scope="module")
def admin_cookies(chromium: Any, cell: Cell) -> list[Any]:
    """What a browser keeps of an administrator who has signed in."""
    with chromium.new_context(base_url=cell.url) as context:
        sign_in(context.new_page(), "/ui/keys", new_key(cell))
        cookies: list[Any] = context.cookies()
    return cookies


@pytest.fixture
def open_page(chromium: Any, cell: Cell, admin_cookies: list[Any]) -> Iterator[Callable[..., Any]]:
    """Return a function that opens a page of a browser of its own, signed in; what goes wrong in it is collected."""
    contexts: list[Any] = []

    def open_(path: str = "/ui/", key: str | None = None, **options: Any) -> Any:
        context = chromium.new_context(
            base_url=cell.url, **{"viewport": {"width": 1280, "height": 900}, **options}
        )
        context.set_default_timeout(HANGS_MS)
        contexts.append(context)
        page = context.new_page()
        page.troubles = []  # what the watchers saw
        host = urlsplit(cell.url).netloc
        page.on("console", lambda one: one.type == "error" and page.troubles.append(f"console: {one.text}"))
        page.on("pageerror", lambda one: page.troubles.append(f"script: {one}"))
        page.on(
            "request",
            lambda one: urlsplit(one.url).netloc in (host, "") or page.troubles.append(f"foreign: {one.url}"),
        )
        if key is None:
            context.add_cookies(admin_cookies)
            page.goto(path)
        else:
            sign_in(page, path, key)
        return page

    yield open_
    for context in contexts:
        context.close()


def sign_in(page: Any, path: str, key: str) -> None:
    """Sign in on the way to a page."""
    page.goto(f"/ui/sign-in?next={path}")
    page.fill("#key", key)
    page.press("#key", "Enter")
    page.wait_for_url(f"**{path}")


def new_key(cell: Cell, scope: str = "admin") -> str:
    return cell.api.key(scope)["Authorization"].removeprefix("Bearer ")


def show(page: Any, width: int, scheme: str = "light") -> None:
    """Give a page's window another width and other colours, and wait until it is drawn so."""
    page.set_viewport_size({"width": width, "height": 900})
    page.emulate_media(color_scheme=scheme)
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


@cache
def _axe() -> str:
    return (Path(str(files("axe_playwright_python"))) / "axe.min.js").read_text(encoding="utf-8")


def violations(page: Any) -> list[str]:
    """Return what axe-core finds against WCAG 2.2 AA and good practice; the policy lets in no script tag."""
    if page.evaluate("typeof axe") == "undefined":
        page.evaluate(_axe())
    asked = json.dumps({"runOnly": TAGS, "resultTypes": ["violations"]})
    found = page.evaluate(f"axe.run(document, {asked}).then((done) => done.violations)")
    return [f"{one['id']}: {node['html'][:200]}" for one in found for node in one["nodes"]]


def is_too_wide(page: Any) -> bool:
    """Return whether the page must be moved sideways to be read."""
    wide = "document.documentElement.scrollWidth > document.documentElement.clientWidth"
    return bool(page.evaluate(wide))
