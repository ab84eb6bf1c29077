"""The address of a request's client, as trusted proxies report it."""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence
from functools import lru_cache

from starlette.datastructures import Headers
from starlette.types import Scope

from app.settings import Network


def client_address(scope: Scope, trusted: Sequence[Network]) -> str | None:
    """Return the client's address; None where the transport has none.

    `X-Forwarded-For` counts only as far as trusted proxies wrote it: from its right end, the first address that is
    not one of theirs. Whatever a client wrote itself stands further left.
    """
    peer = scope.get("client")
    if not peer:
        return None
    address = _bare(str(peer[0])) or str(peer[0])
    if not trusted:
        return address
    entries = [
        entry.strip() for entry in ",".join(Headers(scope=scope).getlist("x-forwarded-for")).split(",")
    ]
    while entries and _is_trusted(address, trusted):
        entry = _bare(entries.pop())
        if entry is None:
            break
        address = entry
    return address


def _is_trusted(address: str, trusted: Sequence[Network]) -> bool:
    try:
        parsed = ipaddress.ip_address(address)
    except ValueError:
        return False
    return any(parsed in network for network in trusted)


@lru_cache(maxsize=4096)
def _bare(entry: str) -> str | None:
    """Return the address of an entry, which may carry a port, or None where it is not an address.

    Of a socket that serves both families, an IPv4 address comes as IPv6: it is the same client. A scope (`%eth0`) says
    nothing outside its host, and may be any text.
    """
    if entry.startswith("["):
        entry = entry[1:].partition("]")[0]
    elif entry.count(":") == 1:
        entry = entry.partition(":")[0]
    if "%" in entry:
        return None
    try:
        address = ipaddress.ip_address(entry)
    except ValueError:
        return None
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return str(mapped or address)
