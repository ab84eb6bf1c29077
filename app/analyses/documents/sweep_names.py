"""How a request names sweeps: `JOINT:POSE,POSE,...`, the joint counted from 1, each pose a pose_id or a pattern with *
(any text) and ? (one character).
"""

from __future__ import annotations

import json
from collections.abc import Iterable

from core.session import natural

PATTERN = r"^[1-9][0-9]?:[A-Za-z0-9._*?-]{1,128}(,[A-Za-z0-9._*?-]{1,128})*$"


def sweeps_setting(names: Iterable[str]) -> str:
    """Return names of sweeps as a setting: the same text for the same sweeps, in whatever order they were named."""
    return json.dumps(sorted({_sorted(name) for name in names}, key=natural))


def sweeps_named(setting: str) -> tuple[str, ...]:
    """Return the names that a setting holds."""
    return tuple(json.loads(setting))


def parsed(name: str) -> tuple[int, list[str]]:
    """Return the joint, counted from 1, and the names and patterns of the poses."""
    joint, _, poses = name.partition(":")
    return int(joint), poses.split(",")


def _sorted(name: str) -> str:
    joint, patterns = parsed(name)
    return f"{joint}:{','.join(sorted(set(patterns), key=natural))}"
