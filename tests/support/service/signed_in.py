"""A browser that is signed in, as the headers of its requests."""

from __future__ import annotations

from typing import Any

from app.http import COOKIE, begin_sign_in
from app.services.keys import create_key


def signed_in(api: Any, scope: str = "admin") -> dict[str, str]:
    """Return the cookie of a browser that is signed in with a key of this scope."""
    key = create_key(api.installation, "browser", scope).key
    return {"Authorization": "", "Cookie": f"{COOKIE}={begin_sign_in(api.installation, key)}"}
