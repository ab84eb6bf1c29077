"""JSON, SVG and CSV with gzip for clients that accept it.

Only answers that are complete in one piece are compressed: event streams and files pass as they are, at once. A
compressed answer is another representation of the same content, so that its entity tag is a weak one (RFC 9110, 8.8.3);
`If-None-Match` compares weakly, and finds it.
"""

from __future__ import annotations

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

MIN_BYTES = 1024
"""Below it, gzip saves less than a packet."""
INLINE_BYTES = 64 * 1024
"""Larger answers are not compressed on the event loop."""
LEVEL = 2
"""Of igzip: a tenth of the time of zlib's usual level 6, for a sixth more bytes."""
_TYPES = ("application/json", "application/problem+json", "image/svg+xml", "text/csv")


class Compression:
    """Compresses answers, and says of all that could be that they vary with `Accept-Encoding`."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        answer = _Answer(send, accepts_gzip(Headers(scope=scope).get("accept-encoding", "")))
        await self._app(scope, receive, answer.send)


class _Answer:
    """One answer on its way; its start is held until its first piece is there."""

    def __init__(self, send: Send, accepted: bool) -> None:
        self._send, self._accepted = send, accepted
        self._start: Message | None = None

    async def send(self, message: Message) -> None:
        """Pass a message on, compressed where it is a whole answer of a type that gains by it."""
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            media_type = headers.get("content-type", "").partition(";")[0].strip().lower()
            if media_type in _TYPES:
                headers.add_vary_header("Accept-Encoding")
                self._start = message
                return
            if message["status"] == 304:
                headers.add_vary_header("Accept-Encoding")
                if self._accepted:
                    _weaken_tag(headers)
        elif self._start is not None:
            start, self._start = self._start, None
            body = message.get("body", b"")
            whole = message["type"] == "http.response.body" and not message.get("more_body", False)
            if self._accepted and whole and len(body) >= MIN_BYTES:
                if len(body) > INLINE_BYTES:
                    body = await run_in_threadpool(_compressed, body)
                else:
                    body = _compressed(body)
                headers = MutableHeaders(scope=start)
                headers["Content-Encoding"] = "gzip"
                headers["Content-Length"] = str(len(body))
                _weaken_tag(headers)
                message = {**message, "body": body}
            await self._send(start)
        await self._send(message)


def _weaken_tag(headers: MutableHeaders) -> None:
    tag = headers.get("etag")
    if tag is not None and not tag.startswith("W/"):
        headers["ETag"] = f"W/{tag}"


def _compressed(body: bytes) -> bytes:
    from isal import igzip  # 2.6 MB, only for those who answer

    return bytes(igzip.compress(body, LEVEL, mtime=0))  # no time in it: the same bytes for the same answer


def accepts_gzip(accept_encoding: str) -> bool:
    """Return whether an Accept-Encoding header allows gzip, by name or by `*` (RFC 9110, 12.5.3)."""
    allowed: dict[str, bool] = {}
    for part in accept_encoding.lower().split(","):
        name, _, parameters = part.partition(";")
        weight = parameters.strip().removeprefix("q=")
        try:
            allowed[name.strip()] = not parameters.strip() or float(weight) > 0.0
        except ValueError:
            allowed[name.strip()] = False
    return allowed.get("gzip", allowed.get("*", False))
