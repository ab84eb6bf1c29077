"""What the API refuses a page: as the fragment that pages show, in their words, in place of the problem document."""

from __future__ import annotations

import json

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.errors import ServiceError
from app.web.pages import asks_for_fragment, environment

_PROBLEM = "application/problem+json"


class PageRefusals:
    """Answers scripts of pages, which say what they are as for any other fragment, in the words of the pages."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if (
            scope["type"] != "http"
            or scope["method"] == "HEAD"
            or not asks_for_fragment(Headers(scope=scope))
        ):
            await self._app(scope, receive, send)
            return
        held: Message | None = None

        async def pass_on(message: Message) -> None:
            nonlocal held
            if message["type"] == "http.response.start":
                if MutableHeaders(scope=message).get("content-type") == _PROBLEM:
                    held = message
                    return
            elif held is not None:  # a problem document comes in one piece
                message = {**message, "body": _fragment(message["body"])}
                headers = MutableHeaders(scope=held)
                headers["Content-Type"] = "text/html; charset=utf-8"
                headers["Content-Length"] = str(len(message["body"]))
                headers.add_vary_header("HX-Request")
                await send(held)
                held = None
            await send(message)

        await self._app(scope, receive, pass_on)


def _fragment(body: bytes) -> bytes:
    problem = json.loads(body)
    error = ServiceError(
        problem["detail"],
        problem["advice"],
        code=problem["code"],
        errors=[(one["field"], one["message"]) for one in problem["errors"]],
    )
    return environment().get_template("_refusal.html").render(error=error).encode()
