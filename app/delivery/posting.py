"""One notice sent to one address: signed, to the address that was examined, with no redirect followed.

What is signed is id, time and body, so that neither an old request nor one with another body passes for a new one. What
the receiver answers is not read beyond its status, and shown to nobody.

Reference: Standard Webhooks 1.0, https://www.standardwebhooks.com
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import hmac
import json
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import httpx2

from app.build import program_version
from app.services.notices import refused_address

WITHIN_S = 15.0
"""For the whole of an attempt, whatever the receiver does."""


@dataclass(frozen=True, slots=True)
class Attempt:
    """What came of sending: the status that was answered, and why it counts as not delivered, None where it is."""

    response_status: int | None
    failure: str | None


class AddressRefused(Exception):
    """The name is one of an address that nothing is sent to."""


def signature_of(secret: bytes, delivery_id: str, at_s: int, body: bytes) -> str:
    """Return the `webhook-signature` of a request: HMAC-SHA256 of `id.time.body`, base64, after its version."""
    signed = f"{delivery_id}.{at_s}.".encode() + body
    return "v1," + base64.b64encode(hmac.new(secret, signed, hashlib.sha256).digest()).decode()


async def post(
    url: str, secret: bytes, delivery_id: str, document: Mapping[str, Any], *, at_s: int
) -> Attempt:
    """Send a document, and return what came of it; never raises but when it is cancelled."""
    body = json.dumps(document, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()
    headers = {
        "Content-Type": "application/json",
        "User-Agent": f"gridpose/{program_version()}",
        "Accept-Encoding": "identity",
        "webhook-id": delivery_id,
        "webhook-timestamp": str(at_s),
        "webhook-signature": signature_of(secret, delivery_id, at_s, body),
    }
    try:
        status = await asyncio.wait_for(_send(url, headers, body), WITHIN_S)
    except TimeoutError:
        return Attempt(None, f"No answer within {WITHIN_S:g} s.")
    except AddressRefused as error:
        return Attempt(None, str(error))
    except (httpx2.HTTPError, httpx2.InvalidURL, OSError, ValueError) as error:
        return Attempt(None, f"The address was not reached ({_reason_of(error)}).")
    if 200 <= status < 300:
        return Attempt(status, None)
    if 300 <= status < 400:
        return Attempt(status, f"The receiver answered {status}; redirects are not followed.")
    return Attempt(status, f"The receiver answered {status}.")


def _reason_of(error: Exception) -> str:
    """Return what failed, in words where they are of this machine: others may hold what the receiver sent."""
    return str(error) if isinstance(error, (httpx2.ConnectError, socket.gaierror)) else type(error).__name__


async def _send(url: str, headers: Mapping[str, str], body: bytes) -> int:
    """Send to the first address of the receiver that takes a connection, and return the status of its answer."""
    asked = httpx2.URL(url)
    addresses = await _examined_addresses(asked.host, asked.port or (443 if asked.scheme == "https" else 80))
    # Of the environment, SSL_CERT_FILE is read: a plant has its own authority.
    async with httpx2.AsyncClient(
        trust_env=False,
        verify=httpx2.create_ssl_context(),
        follow_redirects=False,
        timeout=httpx2.Timeout(WITHIN_S, connect=WITHIN_S / len(addresses)),
    ) as client:
        for address in addresses:
            try:
                async with client.stream(
                    "POST",
                    # The address itself: a name could have another one by the time that it is looked up again.
                    asked.copy_with(host=address),
                    content=body,
                    headers={**headers, "Host": asked.netloc.decode("ascii")},
                    extensions={"sni_hostname": asked.host},
                ) as response:
                    return response.status_code
            except (httpx2.ConnectError, httpx2.ConnectTimeout):
                if address == addresses[-1]:
                    raise
    raise AssertionError("a host has an address")


async def _examined_addresses(host: str, port: int) -> list[str]:
    """Return the addresses of a host, where every one of them may be sent to. Raises AddressRefused, OSError."""
    loop = asyncio.get_running_loop()
    found = await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    addresses = list(dict.fromkeys(str(one[4][0]) for one in found))
    for address in addresses:
        if (reason := refused_address(address)) is not None:
            raise AddressRefused(f"The name stands for {reason}, to which nothing is sent.")
    return addresses
