"""Headers that no address here can honour: they are refused, since to ignore them would do what was not asked for."""

from __future__ import annotations

from collections.abc import Mapping

from app.errors import ContentEncoded, PreconditionFailed

UNSAFE = frozenset({"POST", "PUT", "PATCH", "DELETE"})


def check_headers(method: str, headers: Mapping[str, str]) -> None:
    """Raise PreconditionFailed for a request that changes something only if a tag is current: nothing of that has one.

    Raise ContentEncoded for a compressed body (RFC 9110, 8.4 and 13.1.1).
    """
    if method not in UNSAFE:
        return
    if headers.get("if-match", "*").strip() != "*":
        raise PreconditionFailed(
            "The request is to be done only if an entity tag is current (If-Match); what can be changed here has none.",
            "Nothing was changed. Read it again, compare it with what you know, and send the request without If-Match.",
        )
    encoding = headers.get("content-encoding", "").strip().lower()
    if encoding not in ("", "identity"):
        raise ContentEncoded(
            "The body has a Content-Encoding; bodies are taken as they are.",
            "Send it without compression and without Content-Encoding.",
        )
