"""A session's page while images are measured: how soon it shows a result, and by how much workers are slower.

What a page costs the service is measured by a reader that asks for what the page asks for, in a process of its own: the
events, the images' part of the page after each change (at most every .7 s), and the thumbnails on it that are new. A
browser on the same machine takes cores of its own for drawing; that is measured, too, and is no cost of the service.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import re
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from datetime import datetime
from multiprocessing.synchronize import Event
from pathlib import Path
from statistics import median
from typing import Any

import cv2
import httpx2
from playwright.sync_api import sync_playwright

from app.cli.demo.service_process import ServiceProcess
from app.client import ServiceClient
from benchmarks.service.browser.visits import launched, signed_in_cookies
from benchmarks.service.connection import variant
from benchmarks.service.throughput import TARGET, await_all, new_session
from benchmarks.table import Row
from core.simulation import render
from tests.support.simulation.scenes import standard_scene

REFRESH_S = 0.7
"""As `session.js` has it."""
THUMBNAIL_MS, UPDATE_S, SLOWDOWN_PERCENT = 15.0, 1.0, 5.0
_THUMBNAIL = re.compile(r'src="(/v1/measurements/[^"]+/thumbnail)"')


def live_rows(chromium: str, seeds: list[int], quick: bool) -> Iterable[Row]:
    """Measure thumbnails, updates and the workers' images per second with and without an open page."""
    images, turns, updates = (24, 1, 3) if quick else (96, 6, 15)
    encoded = [
        cv2.imencode(".png", render(standard_scene(TARGET, 1000 * seed + k)))[1].tobytes()
        for seed in seeds
        for k in range(2)
    ]
    with (
        tempfile.TemporaryDirectory(prefix="gridpose-bench-") as name,
        sync_playwright() as playwright,
        ServiceProcess(Path(name), {"GRIDPOSE_WORKERS": "2"}) as service,
        ServiceClient(service.url, service.admin_key) as client,
    ):
        assert service.admin_key is not None
        sent = _numbered(encoded)
        browser = launched(playwright, chromium)
        cookies = signed_in_cookies(browser, service.url, service.admin_key)
        _measure(client, sent, 16)  # the first ones load the workers
        yield _thumbnail_row(client, service.url, service.admin_key, sent)
        yield _update_row(client, browser, service.url, cookies, sent, updates)
        header = "; ".join(f"{one['name']}={one['value']}" for one in cookies)

        def read(session_id: str) -> AbstractContextManager[None]:
            return _reader(service.url, session_id, header)

        def watch(session_id: str) -> AbstractContextManager[None]:
            return _watching(browser, service.url, session_id, cookies)

        rates: dict[str, list[float]] = {"alone": [], "read": [], "watched": []}
        opened: dict[str, Callable[[str], AbstractContextManager[None]]] = {
            "alone": lambda _: nullcontext(),
            "read": read,
            "watched": watch,
        }
        for turn in range(turns):
            names = list(opened) if turn % 2 == 0 else list(opened)[::-1]
            for what in names:
                rates[what].append(_measure(client, sent, images, opened[what]))
        browser.close()
    slower = {what: _slowdown(rates["alone"], rates[what]) for what in ("read", "watched")}
    spread = max(rates["alone"]) / min(rates["alone"])
    note = (
        f"{turns} turns of {images} images of 5 Mpx; the events, the images and their thumbnails are asked for as the "
        f"page does, without a browser; {median(rates['alone']):.1f} images/s alone, largest ÷ smallest {spread:.2f}"
    )
    yield Row.at_most("workers slower by an open live page", slower["read"], SLOWDOWN_PERCENT, "%", note)
    note = "drawing takes part of the two cores that the workers use; no cost where the reader has another machine"
    yield Row.context("the same with Chromium on the service's cores", slower["watched"], "%", note)


def _slowdown(alone: Sequence[float], opened: Sequence[float]) -> float:
    return 100.0 * (1.0 - median(o / a for o, a in zip(opened, alone, strict=True)))


def _numbered(encoded: Sequence[bytes]) -> Iterator[bytes]:
    """Yield images of another hash each, without end."""
    number = 0
    while True:
        yield variant(encoded[number % len(encoded)], number)
        number += 1


def _measure(
    client: ServiceClient,
    sent: Iterator[bytes],
    images: int,
    opened: Callable[[str], AbstractContextManager[None]] = lambda _: nullcontext(),
) -> float:
    """Send images to a session of their own; return how many of them are measured in a second.

    All are stored first as fast as they are sent; the rate is from the first result to the last.
    """
    session_id = new_session(client)
    with opened(session_id):
        for _ in range(images):
            _send(client, session_id, next(sent))
        await_all(client, session_id, images)
    finished = sorted(
        datetime.fromisoformat(one["finished_at"])
        for one in client.items(f"/v1/sessions/{session_id}/measurements")
    )
    return (images - 1) / (finished[-1] - finished[0]).total_seconds()


def _send(client: ServiceClient, session_id: str, data: bytes) -> str:
    sent = client.put_image(session_id, "P1", hashlib.sha256(data).hexdigest(), data)
    return str(sent["id"])


def _thumbnail_row(client: ServiceClient, url: str, key: str, sent: Iterator[bytes]) -> Row:
    session_id = new_session(client)
    measured = _send(client, session_id, next(sent))
    await_all(client, session_id, 1)
    took = []
    with httpx2.Client(base_url=url, headers={"Authorization": f"Bearer {key}"}) as http:
        for _ in range(60):
            started = time.perf_counter()
            answer = http.get(f"/v1/measurements/{measured}/thumbnail")
            took.append(1e3 * (time.perf_counter() - started))
            assert answer.status_code == 200
    kept = took[10:]
    note = f"of an image of 5 Mpx; median of {len(kept)}, worst {max(kept):.1f} ms"
    return Row.at_most("thumbnail, warm", median(kept), THUMBNAIL_MS, "ms", note)


def _update_row(
    client: ServiceClient, browser: Any, url: str, cookies: list[Any], sent: Iterator[bytes], updates: int
) -> Row:
    """Time from when the service has a result until the page shows it."""
    session_id = new_session(client)
    late = []
    with _page(browser, url, session_id, cookies) as page:
        for number in range(1, updates + 1):
            _send(client, session_id, next(sent))
            while client.get(f"/v1/sessions/{session_id}")["counts"]["queued"]:
                time.sleep(0.005)
            while client.get(f"/v1/sessions/{session_id}")["counts"]["running"]:
                time.sleep(0.005)
            has_it = time.perf_counter()
            page.wait_for_selector(f".count-done:text-is('{number}')")
            late.append(time.perf_counter() - has_it)
    note = f"counts on the page after the API has the result; median of {updates}, worst {max(late):.2f} s"
    return Row.at_most("live update after a result", median(late), UPDATE_S, "s", note)


@contextmanager
def _page(browser: Any, url: str, session_id: str, cookies: list[Any]) -> Iterator[Any]:
    context = browser.new_context(base_url=url, viewport={"width": 1280, "height": 900})
    context.add_cookies(cookies)
    page = context.new_page()
    page.goto(f"/ui/sessions/{session_id}", wait_until="domcontentloaded")
    page.wait_for_selector("#theme:not([hidden])")
    try:
        yield page
    finally:
        context.close()


@contextmanager
def _watching(browser: Any, url: str, session_id: str, cookies: list[Any]) -> Iterator[None]:
    with _page(browser, url, session_id, cookies):
        yield


@contextmanager
def _reader(url: str, session_id: str, cookie: str) -> Iterator[None]:
    """Read a session's page in a process of its own while the block runs."""
    context = multiprocessing.get_context("spawn")
    ready, ended = context.Event(), context.Event()
    process = context.Process(target=read_live, args=(url, session_id, cookie, ready, ended), daemon=True)
    process.start()
    assert ready.wait(60.0), "the reader begins"
    try:
        yield
    finally:
        ended.set()
        process.join(10.0)
        process.kill()


def read_live(url: str, session_id: str, cookie: str, ready: Event, ended: Event) -> None:
    """Ask for what an open page asks for until `ended` is set."""
    seen: set[str] = set()
    asked = 0.0
    former = None
    headers = {"Cookie": cookie}
    with httpx2.Client(base_url=url, headers=headers, timeout=60.0) as http:
        http.get(f"/ui/sessions/{session_id}").raise_for_status()
        with http.stream("GET", f"/v1/sessions/{session_id}/events") as events:
            events.raise_for_status()
            ready.set()
            for line in events.iter_lines():
                if ended.is_set():
                    return
                if not line.startswith("data:"):
                    continue
                counts = json.loads(line.removeprefix("data:")).get("counts")
                if counts == former or time.monotonic() - asked < REFRESH_S:
                    continue
                former, asked = counts, time.monotonic()
                shown = http.get(f"/ui/sessions/{session_id}", headers={"HX-Request": "true"})
                for address in dict.fromkeys(_THUMBNAIL.findall(shown.text)):
                    if address not in seen:
                        seen.add(address)
                        http.get(address)
