"""Where a service without keys (GRIDPOSE_AUTH=off) may be called from: this machine, and no page of another host.

A page of another host can make a browser on this machine send requests here, by a name that it lets point to 127.0.0.1
(DNS rebinding) or straight. The browser says so in `Host`, `Origin` and `Sec-Fetch-Site`.
"""

from __future__ import annotations

import ipaddress

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from app.api.problems import service_problem
from app.errors import NotAllowed


class LoopbackOnly:
    """Refuses, on every address, what was not asked by a loopback name or comes from another origin (403)."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            try:
                check_caller(Headers(scope=scope))
            except NotAllowed as error:
                await service_problem(error)(scope, receive, send)
                return
        await self._app(scope, receive, send)


def check_caller(headers: Headers) -> None:
    """Raise NotAllowed for a `Host` that is no loopback name, and for an `Origin` that is not this service's."""
    hosts = headers.getlist("host")
    if len(hosts) != 1 or not is_loopback_host(hosts[0]):
        raise NotAllowed(
            "Without keys this service answers to names of its own machine alone.",
            "Use http://127.0.0.1 and the port, or start the service with GRIDPOSE_AUTH=on and use keys.",
            code="foreign_host",
        )
    own = {f"{scheme}://{hosts[0].lower()}" for scheme in ("http", "https")}
    foreign = any(origin.lower() not in own for origin in headers.getlist("origin"))
    if foreign or "cross-site" in [site.strip().lower() for site in headers.getlist("sec-fetch-site")]:
        raise NotAllowed(
            "Without keys this service answers no page of another origin.",
            "Open the service's own pages, or start it with GRIDPOSE_AUTH=on and use keys.",
            code="foreign_origin",
        )


def is_loopback_host(value: str) -> bool:
    """Return whether a `Host` header names this machine: `localhost`, 127.0.0.0/8 or `[::1]`, with or without port."""
    name, port = value.strip().lower(), ""
    if name.startswith("["):
        name, closed, port = name[1:].partition("]")
        if not closed or (port and not port.startswith(":")):
            return False
        port = port.removeprefix(":")
        version = 6
    else:
        name, _, port = name.partition(":")
        version = 4
    if port and not (port.isascii() and port.isdecimal()):
        return False
    if name == "localhost":
        return version == 4
    try:
        address = ipaddress.ip_address(name)
    except ValueError:
        return False
    return address.version == version and address.is_loopback
