"""The outermost middleware: request ids, headers, metrics, access log, and the response to unhandled exceptions."""

from __future__ import annotations

import asyncio
import re
import secrets
import time
from collections.abc import Sequence

import structlog
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.api.metrics import Metrics
from app.api.middleware.client_address import client_address
from app.api.problems import NEXT_PIECE_WITHIN_S, internal_problem, service_problem
from app.errors import refusal_of
from app.logs import Logger
from app.settings import Network

log = Logger(__name__)

_STREAM = re.compile(r"/v1/sessions/[^/]+/events")
_REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")
_DRAIN_BYTES = 256 * 1024 * 1024
_DRAIN_S = 5.0
_MAX_DIGITS = 20
_QUIET = ("/livez", "/readyz", "/metrics")
_CONTENT_SECURITY_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = (
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"content-security-policy", _CONTENT_SECURITY_POLICY.encode()),
    (b"cache-control", b"no-store"),
)


class RequestMiddleware:
    """Wraps the whole application."""

    def __init__(self, app: ASGIApp, metrics: Metrics, trusted_proxies: Sequence[Network] = ()) -> None:
        self._app = app
        self._metrics = metrics
        self._trusted_proxies = trusted_proxies

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        client = client_address(scope, self._trusted_proxies)
        await _Exchange(self._app, self._metrics, client, scope, receive, send).run()


def _with_one_line_of_tags(scope: Scope) -> Scope:
    """Return a request with its entity tags joined in one header line, which is equivalent to several (RFC 9110, 5.3).

    Of several lines, the framework would hand over the first alone.
    """
    lines = [value for name, value in scope["headers"] if name == b"if-none-match"]
    if len(lines) < 2:
        return scope
    others = [(name, value) for name, value in scope["headers"] if name != b"if-none-match"]
    return {**scope, "headers": [*others, (b"if-none-match", b", ".join(lines))]}


class _Exchange:
    """One request and its answer."""

    def __init__(
        self,
        app: ASGIApp,
        metrics: Metrics,
        client: str | None,
        scope: Scope,
        receive: Receive,
        send: Send,
    ) -> None:
        self._app, self._metrics = app, metrics
        self._method = scope["method"]
        # What may be read may be asked about: HEAD is GET without the body. An event stream has no end to await.
        self._is_head = self._method == "HEAD" and not _STREAM.fullmatch(scope["path"])
        self._scope = _with_one_line_of_tags({**scope, "method": "GET"} if self._is_head else scope)
        self._receive, self._send = receive, send
        headers = dict(scope["headers"])
        offered = headers.get(b"x-request-id", b"").decode("latin-1")
        self.request_id = offered if _REQUEST_ID.fullmatch(offered) else secrets.token_hex(8)
        # What the layers below read, and what they add: `key`, `activity`.
        self._state = self._scope.setdefault("state", {})
        self._state.update(client=client, request_id=self.request_id)
        # A client that waits for `100 Continue` has sent nothing that needs draining.
        self._may_drain = headers.get(b"expect", b"").lower() != b"100-continue"
        self._body_complete = b"content-length" not in headers and b"transfer-encoding" not in headers
        announced = headers.get(b"content-length", b"").decode("latin-1")
        self._announced = int(announced) if announced.isdecimal() and len(announced) <= _MAX_DIGITS else 0
        self._received = 0
        self._status = 0
        self._answered: float | None = None

    async def run(self) -> None:
        started = time.perf_counter()
        try:
            with structlog.contextvars.bound_contextvars(request_id=self.request_id):
                await self._answer()
        finally:
            self._note((self._answered or time.perf_counter()) - started)

    async def _answer(self) -> None:
        try:
            await self._app(self._scope, self._read, self._write)
        except Exception as error:
            log.error("request_failed", method=self._method, route=self._route(), exc_info=error)
            if self._status:
                raise
            refusal = refusal_of(error) if isinstance(error, OSError) else None
            answer = internal_problem() if refusal is None else service_problem(refusal)
            await answer(self._scope, self._read, self._write)

    async def _read(self) -> Message:
        if self._body_complete:
            return await self._receive()
        try:
            async with asyncio.timeout(NEXT_PIECE_WITHIN_S):
                message = await self._receive()
        except TimeoutError:
            # A client that fell silent is as good as gone; its connection is closed after the answer.
            self._may_drain = False
            return {"type": "http.disconnect"}
        self._received += len(message.get("body", b""))
        if message["type"] != "http.request" or not message.get("more_body", False):
            self._body_complete = True
        return message

    async def _write(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self._status = int(message["status"])
            own = list(message.get("headers", ()))
            given = {name.lower() for name, _ in own}  # pages of the dashboard have policies of their own
            headers = [*own, (b"x-request-id", self.request_id.encode())]
            headers += [header for header in _HEADERS if header[0] not in given]
            if not self._body_complete and not self._will_drain():
                headers.append((b"connection", b"close"))
            message = {**message, "headers": headers}
        elif message["type"] == "http.response.body":
            if self._is_head:
                message = {**message, "body": b""}
            if not message.get("more_body", False):
                await self._write_last(message)
                return
        await self._send(message)

    async def _write_last(self, message: Message) -> None:
        """Send the answer's last part at once, however much of the request is still to come.

        Only then the rest of the request is read for a while, so that a client still sending comes to read the answer,
        and the connection can be kept; the end of the answer, which may close it, is said after that.
        """
        self._answered = time.perf_counter()
        if not self._body_complete and self._may_drain:
            await self._send({**message, "more_body": True})
            message = {**message, "body": b""}
            await self._drain()
        await self._send(message)

    def _will_drain(self) -> bool:
        """Return whether the rest of the request may be read after the answer; an unannounced rest may be short."""
        return self._may_drain and self._announced - self._received <= _DRAIN_BYTES

    async def _drain(self) -> None:
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
            key, activity = self._state.get("key"), self._state.get("activity")
            log.info(
                "request",
                request_id=self.request_id,
                method=method,
                route=route,
                status=self._status,
                duration_ms=round(duration_s * 1000.0, 2),
                client=self._state["client"],
                key_id=getattr(key, "id", None),
                action=getattr(activity, "action", None),
                object_ids=getattr(activity, "object_ids", []),
            )
