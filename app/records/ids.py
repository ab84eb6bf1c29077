"""Ids: opaque to clients, ordered by time for us."""

from __future__ import annotations

import re
import secrets
import threading
import time

_ALPHABET = "0123456789abcdefghjkmnpqrstvwxyz"  # Crockford's base 32: no i, l, o, u
_LENGTH = 26
_SHAPE = re.compile(rf"[a-z]{{3}}_[{_ALPHABET}]{{{_LENGTH}}}")

_lock = threading.Lock()
_last = 0


def new_id(prefix: str) -> str:
    """Return `prefix`, an underscore, and 26 digits: milliseconds, then 80 random bits.

    Within this process every id is greater than the one before, whatever the clock does.
    """
    global _last
    with _lock:
        _last = max(_last + 1, (time.time_ns() // 1_000_000) << 80 | secrets.randbits(80))
        value = _last
    digits = []
    for _ in range(_LENGTH):
        value, digit = divmod(value, 32)
        digits.append(_ALPHABET[digit])
    return f"{prefix}_{''.join(reversed(digits))}"


def is_id(text: str) -> bool:
    """Tell whether `text` could be an id of ours; what could not is never looked up."""
    return _SHAPE.fullmatch(text) is not None
