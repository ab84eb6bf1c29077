"""The outermost layer: request ids, headers, counting, logging, and the last word on defects."""

from __future__ import annotations

import asyncio
import re
import secrets
import time

import structlog
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.api.metrics import Metrics
from app.api.problems import internal_problem

log = structlog.get_logger(__name__)

_REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")
_DRAIN_BYTES = 256 * 1024 * 1024
_DRAIN_S = 5.0
_NEXT_PIECE_WITHIN_S = 60.0
_QUIET = ("/livez", "/readyz", "/metrics")
_CONTENT_SECURITY_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


class Edge:
    """Wraps the whole application."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self._app = app
        self._metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        await _Exchange(self._app, self._metrics, scope, receive, send).run()


def _with_one_line_of_tags(scope: Scope) -> Scope:
    """Return a request whose entity tags stand in one header line, which is the same as in several (RFC 9110, 5.3).

    Of several lines, the framework would hand over the first alone.
    """
    lines = [value for name, value in scope["headers"] if name == b"if-none-match"]
    if len(lines) < 2:
        return scope
    others = [(name, value) for name, value in scope["headers"] if name != b"if-none-match"]
    return {**scope, "headers": [*others, (b"if-none-match", b", ".join(lines))]}


class _Exchange:
    """One request and its answer."""

    def __init__(self, app: ASGIApp, metrics: Metrics, scope: Scope, receive: Receive, send: Send) -> None:
        self._app, self._metrics = app, metrics
        self._method = scope["method"]
        # What may be read may be asked about: HEAD is GET without the body. An event stream has no end to await.
        self._is_head = self._method == "HEAD" and not scope["path"].endswith("/events")
        self._scope = _with_one_line_of_tags({**scope, "method": "GET"} if self._is_head else scope)
        self._receive, self._send = receive, send
        headers = Headers(scope=scope)
        offered = headers.get("x-request-id", "")
        self.request_id = offered if _REQUEST_ID.fullmatch(offered) else secrets.token_hex(8)
        # Somebody who waits to be told to go on has nothing under way that needs draining.
        self._may_drain = headers.get("expect", "").lower() != "100-continue"
        self._body_complete = "content-length" not in headers and "transfer-encoding" not in headers
        self._status = 0

    async def run(self) -> None:
        started = time.perf_counter()
        try:
            with structlog.contextvars.bound_contextvars(request_id=self.request_id):
                await self._answer()
        finally:
            self._note(time.perf_counter() - started)

    async def _answer(self) -> None:
        try:
            await self._app(self._scope, self._read, self._write)
        except Exception as error:
            log.error("request_failed", method=self._method, route=self._route(), exc_info=error)
            if self._status:
                raise
            await internal_problem()(self._scope, self._read, self._write)

    async def _read(self) -> Message:
        if self._body_complete:
            return await self._receive()
        try:
            async with asyncio.timeout(_NEXT_PIECE_WITHIN_S):
                message = await self._receive()
        except TimeoutError:
            # A client that fell silent is as good as gone; its connection is closed after the answer.
            self._may_drain = False
            return {"type": "http.disconnect"}
        if message["type"] != "http.request" or not message.get("more_body", False):
            self._body_complete = True
        return message

    async def _write(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self._status = int(message["status"])
            headers = MutableHeaders(scope=message)
            headers["X-Request-ID"] = self.request_id
            headers["X-Content-Type-Options"] = "nosniff"
            headers["Referrer-Policy"] = "no-referrer"
            headers["Content-Security-Policy"] = _CONTENT_SECURITY_POLICY
            headers.setdefault("Cache-Control", "no-store")
            if self._status >= 400 and not self._body_complete:
                if self._may_drain:
                    await self._drain()
                if not self._body_complete:
                    headers["Connection"] = "close"
        elif self._is_head and message["type"] == "http.response.body":
            message = {**message, "body": b""}
        await self._send(message)

    async def _drain(self) -> None:
        """Read on for a while, so that a client still sending comes to read the answer."""
        rest = _DRAIN_BYTES
        try:
            async with asyncio.timeout(_DRAIN_S):
                while rest > 0 and not self._body_complete:
                    rest -= len((await self._read()).get("body", b""))
        except TimeoutError:
            return

    def _route(self) -> str:
        route = self._scope.get("route")
        return getattr(route, "path", "unmatched")

    def _note(self, duration_s: float) -> None:
        method, route = self._method, self._route()
        self._metrics.request_done(method, route, self._status, duration_s)
        if self._scope["path"] not in _QUIET:
            log.info(
                "request",
                request_id=self.request_id,
                method=method,
                route=route,
                status=self._status,
                duration_ms=round(duration_s * 1000.0, 2),
            )
