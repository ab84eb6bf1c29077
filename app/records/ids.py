"""Ids: opaque to clients, ordered by time for us."""

from __future__ import annotations

import re
import secrets
import threading
import time
from collections.abc import Iterable
from datetime import UTC, datetime, timedelta

_ALPHABET = "0123456789abcdefghjkmnpqrstvwxyz"  # Crockford's base 32: no i, l, o, u
_LENGTH = 26
_PAIRS = [first + second for first in _ALPHABET for second in _ALPHABET]
_SHIFTS = range(5 * (_LENGTH - 2), -1, -10)
_SHAPE = re.compile(rf"[a-z]{{3}}_[{_ALPHABET}]{{{_LENGTH}}}")

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)

_lock = threading.Lock()
_last = 0


def new_id(prefix: str) -> str:
    """Return `prefix`, an underscore, and 26 digits: milliseconds, then 80 random bits.

    Within this process every id is greater than the one before, whatever the clock does, and greater than those
    that `follow` was given.
    """
    global _last
    with _lock:
        _last = max(_last + 1, (time.time_ns() // 1_000_000) << 80 | secrets.randbits(80))
        value = _last
    return _id_of(prefix, value)


def least_id(prefix: str, moment: datetime) -> str:
    """Return the least id that can be made at this time."""
    return _id_of(prefix, int((moment - _EPOCH) / timedelta(milliseconds=1)) << 80)


def _id_of(prefix: str, value: int) -> str:
    return f"{prefix}_{''.join([_PAIRS[value >> shift & 1023] for shift in _SHIFTS])}"


def moment_of(row_id: str) -> datetime:
    """Return when an id was made, to the millisecond; later where the clock had been set back."""
    value = 0
    for digit in row_id[4:]:
        value = value * 32 + _ALPHABET.index(digit)
    return _EPOCH + timedelta(milliseconds=value >> 80)


def follow(ids: Iterable[str]) -> None:
    """Make every id to come greater than `ids`: the clock may have been set back since those were made."""
    global _last
    with _lock:
        for known in ids:
            value = 0
            for digit in known.rpartition("_")[2]:
                value = value * 32 + _ALPHABET.index(digit)
            _last = max(_last, value)


def is_id(text: str) -> bool:
    """Return whether `text` has the form of an id of this service; any other text is never looked up."""
    return _SHAPE.fullmatch(text) is not None
