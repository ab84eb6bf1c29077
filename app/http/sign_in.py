"""Sign-in of a browser by key: a signed token in an HttpOnly cookie, and the CSRF token that belongs to it.

The cookie names the key and never holds its secret. Every request finds the key anew, so that a revoked or expired key
ends every sign-in with it. Nothing is stored: the token carries its key's id, when it began and a random number, under
an HMAC-SHA256 whose secret is derived from the server's pepper.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
import time
from dataclasses import dataclass

from app.records.tables import ApiKey
from app.services.installation.context import ServiceContext
from app.services.keys import find_key_by_id

COOKIE = "gridpose_sign_in"
CSRF_HEADER = "x-csrf-token"
LASTS_S = 12 * 3600
"""How long a sign-in lasts without use; pages renew it."""
RENEWED_AFTER_S = 3600
_SHAPE = re.compile(r"([0-9a-z_]{5,40})\.([0-9]{1,12})\.([0-9a-f]{32})\.([0-9a-f]{64})", re.ASCII)


@dataclass(frozen=True, slots=True)
class SignIn:
    """One browser's sign-in: a key in force, when the cookie was made (Unix time), and its random number."""

    key: ApiKey
    made_at: int
    nonce: str

    @property
    def wants_renewal(self) -> bool:
        """Whether the cookie is so old that the next page makes it anew."""
        return time.time() - self.made_at > RENEWED_AFTER_S


def begin_sign_in(installation: ServiceContext, key: ApiKey, nonce: str | None = None) -> str:
    """Return the cookie's value for a key; with the `nonce` of an earlier one, its forms stay valid."""
    body = f"{key.id}.{int(time.time())}.{nonce or secrets.token_hex(16)}"
    return f"{body}.{_mac(installation, 'sign-in', body)}"


def read_sign_in(installation: ServiceContext, cookie: str) -> SignIn | None:
    """Return the sign-in of a cookie; None where it is not ours, too old, or its key no longer in force."""
    match = _SHAPE.fullmatch(cookie)
    if match is None:
        return None
    key_id, made_at, nonce, mac = match.groups()
    if not hmac.compare_digest(mac, _mac(installation, "sign-in", f"{key_id}.{made_at}.{nonce}")):
        return None
    if not -60.0 <= time.time() - int(made_at) <= LASTS_S:
        return None
    key = find_key_by_id(installation, key_id)
    return None if key is None else SignIn(key, int(made_at), nonce)


def csrf_token(installation: ServiceContext, nonce: str) -> str:
    """Return the token that every unsafe request of this browser carries."""
    return _mac(installation, "csrf", nonce)


def _mac(installation: ServiceContext, purpose: str, text: str) -> str:
    secret = hmac.new(installation.pepper, f"dashboard {purpose}".encode(), hashlib.sha256).digest()
    return hmac.new(secret, text.encode(), hashlib.sha256).hexdigest()
