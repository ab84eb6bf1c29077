"""An HTTP proxy that fails as networks and servers do, and counts what got through."""

from __future__ import annotations

import random
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import Literal, Self

import httpx2

Fault = Literal["none", "cut before", "cut after", "busy", "slow", "twice"]
FAULTS: tuple[Fault, ...] = ("cut before", "cut after", "busy", "slow", "twice")
_SLOW_S = 0.05
_HEADERS = ("authorization", "content-type", "accept")


class FaultProxy:
    """Forwards requests to a service, with a fault for each as `plan` says.

    `cut before`: the connection ends before the service sees the request; `cut after`: after it has acted, without an
    answer; `busy`: 503 of a reverse proxy; `slow`: later; `twice`: the service gets the request twice. `stored` has
    how often the service acknowledged each image (path) as new, and `answered` how often the client was answered so.
    """

    def __init__(
        self, upstream: str, plan: Callable[[str, str], Fault] = lambda method, path: "none"
    ) -> None:
        self.plan = plan
        self.away = False
        self.stored: defaultdict[str, list[int]] = defaultdict(list)
        self.answered: defaultdict[str, list[int]] = defaultdict(list)
        self.faults: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._http = httpx2.Client(base_url=upstream, timeout=60.0)
        proxy = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def handle_any(self) -> None:
                proxy._handle(self)

            do_GET = do_PUT = do_POST = do_PATCH = do_DELETE = handle_any

            def log_message(self, *_: object) -> None:
                return

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        self._server.handle_error = lambda *_: None  # clients are killed
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._server.server_address[1]}"

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
        self._http.close()

    def _handle(self, request: BaseHTTPRequestHandler) -> None:
        body = request.rfile.read(int(request.headers.get("content-length") or 0))
        with self._lock:
            fault = "cut before" if self.away else self.plan(request.command, request.path)
            self.faults[fault] += 1
        if fault == "cut before":
            request.close_connection = True
            return
        if fault == "busy":
            self._answer(request, 503, b"<html>busy</html>", "text/html")
            return
        if fault == "slow":
            time.sleep(_SLOW_S)
        for _ in range(2 if fault == "twice" else 1):
            response = self._http.request(
                request.command,
                request.path,
                content=body,
                headers={name: request.headers[name] for name in _HEADERS if name in request.headers},
            )
            self._note(self.stored, request, response.status_code)
        if fault == "cut after":
            request.close_connection = True
            return
        self._note(self.answered, request, response.status_code)
        self._answer(request, response.status_code, response.content, response.headers.get("content-type"))

    def _note(self, where: dict[str, list[int]], request: BaseHTTPRequestHandler, status: int) -> None:
        if request.command == "PUT" and "/images/" in request.path:
            with self._lock:
                where[request.path.partition("?")[0]].append(status)

    @staticmethod
    def _answer(request: BaseHTTPRequestHandler, status: int, body: bytes, kind: str | None) -> None:
        request.send_response(status)
        if kind is not None:
            request.send_header("content-type", kind)
        request.send_header("content-length", str(len(body)))
        request.end_headers()
        request.wfile.write(body)


def at_random(seed: int, share: float) -> Callable[[str, str], Fault]:
    """Return a plan under which this share of all requests meets a fault.

    Each round of `len(FAULTS)` faults has every kind once, in an order of its own. Drawn independently, a kind could be
    missing from a run: how many requests a client makes depends on its speed.
    """
    rng = random.Random(seed)
    coming: list[Fault] = []

    def plan(method: str, path: str) -> Fault:
        if rng.random() >= share:
            return "none"
        if not coming:
            coming.extend(rng.sample(FAULTS, len(FAULTS)))
        return coming.pop()

    return plan
