"""Readings that a session holds already with another content: a second import in place of a correction.

A reading without a cycle is a visit of its own, so that a file which is sent again with joint angles, with rotations or
with uncertainties would count twice. Such a reading has the pose and the position of a stored one, to the last digit.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from ... import Json, ServiceClient
from ..record_files import FileRefused

_CONTENT = ("joint_angles_deg", "rotation", "covariance")
_DECIMALS = 6
_RELATIVE, _ABSOLUTE = 1e-6, 1e-9
_MAX_SHARE = 0.5
"""Of the readings sent: a coarse instrument may give a few positions twice, but not most of them."""


def refuse_restated(client: ServiceClient, session_id: str, session: str, poses: Sequence[Json]) -> None:
    """Raise FileRefused where most of the readings are stored in the session with another content."""
    if all(pose.get("cycle") is not None for pose in poses):
        return
    count = restated(client.items(f"/v1/sessions/{session_id}/measured-poses"), poses)
    if count > _MAX_SHARE * len(poses):
        raise FileRefused(
            f"{count} of these {len(poses)} readings are stored already, with other joint angles, rotations or "
            "uncertainties. Without a cycle each would count twice; nothing was sent.",
            f'To replace those stored, delete them first: gridpose measured-poses delete "{session}" --all, or --pose. '
            "If these are other visits, give --accept-implausible.",
        )


def restated(stored: Iterable[Json], poses: Sequence[Json]) -> int:
    """Return how many readings without a cycle are stored without one, at the same position with another content."""
    held: dict[tuple[Any, ...], list[Json]] = {}
    for reading in stored:
        if reading.get("cycle") is None:
            held.setdefault(_key(reading), []).append(reading)
    count = 0
    for pose in poses:
        same_place = held.get(_key(pose), []) if pose.get("cycle") is None else []
        count += bool(same_place) and not any(_same(pose, other) for other in same_place)
    return count


def _key(reading: Json) -> tuple[Any, ...]:
    return (reading["pose_id"], *(round(value, _DECIMALS) for value in reading["position_mm"]))


def _same(a: Json, b: Json) -> bool:
    for name in _CONTENT:
        mine, other = list(_numbers(a.get(name))), list(_numbers(b.get(name)))
        if len(mine) != len(other) or not all(
            math.isclose(x, y, rel_tol=_RELATIVE, abs_tol=_ABSOLUTE) for x, y in zip(mine, other, strict=True)
        ):
            return False
    return True


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, list):
        for one in value:
            yield from _numbers(one)
    elif value is not None:
        yield float(value)
