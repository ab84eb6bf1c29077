"""How each controller's programs write a point: what its numbers mean, and with how many decimals."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import PurePath

from ...rotations import (
    Frame,
    from_quaternion,
    from_roll_pitch_yaw,
    from_vector,
    to_quaternion,
    to_roll_pitch_yaw,
    to_vector,
)
from .frames import FramesOf, krl_frames, rapid_frames, tp_frames, urscript_frames
from .points import Found, krl, rapid, tp, urscript


class Controller(enum.StrEnum):
    """Makes of controllers whose programs can be read and written."""

    kuka = "kuka"
    abb = "abb"
    ur = "ur"
    fanuc = "fanuc"


@dataclass(frozen=True, slots=True)
class Language:
    """The points of one controller's programs.

    Parameters
    ----------
    find
        The points of a text.
    frames
        The frames that it names for them.
    frame_of, numbers_of
        Between the numbers of a Cartesian point and its frame.
    degrees
        In one unit of a joint angle.
    decimals
        Of a joint angle, and of each number of a Cartesian point.
    """

    find: Callable[[str], Iterator[Found]]
    frames: FramesOf
    frame_of: Callable[[Sequence[float]], Frame]
    numbers_of: Callable[[Frame], Sequence[float]]
    degrees: float
    joint_decimals: int
    decimals: tuple[int, ...]


def controller_of(path: PurePath) -> Controller | None:
    """Return the controller whose programs have such a name; None for a table."""
    return _SUFFIXES.get(path.suffix.lower())


def _of_angles(numbers: Sequence[float], order: Sequence[int]) -> Frame:
    roll, pitch, yaw = (math.radians(numbers[3 + i]) for i in order)
    return Frame(from_roll_pitch_yaw(roll, pitch, yaw), list(numbers[:3]))


def _angles_of(frame: Frame) -> list[float]:
    return [math.degrees(angle) for angle in to_roll_pitch_yaw(frame.rotation)]


def _of_quaternion(numbers: Sequence[float]) -> Frame:
    w, x, y, z = numbers[3:]
    if not math.hypot(w, x, y, z) > 0.0:
        raise ValueError("a quaternion of zeros is no rotation")
    return Frame(from_quaternion(x, y, z, w), list(numbers[:3]))


def _quaternion_of(frame: Frame) -> list[float]:
    x, y, z, w = to_quaternion(frame.rotation)
    return [*frame.position_mm, w, x, y, z]


LANGUAGES = {
    Controller.kuka: Language(
        krl,
        krl_frames,
        lambda numbers: _of_angles(numbers, (2, 1, 0)),  # A, B, C: about z, y, x
        lambda frame: [*frame.position_mm, *reversed(_angles_of(frame))],
        *(1.0, 5, (4, 4, 4, 5, 5, 5)),
    ),
    Controller.abb: Language(
        rapid, rapid_frames, _of_quaternion, _quaternion_of, 1.0, 5, (4, 4, 4, 9, 9, 9, 9)
    ),
    Controller.ur: Language(
        urscript,
        urscript_frames,
        lambda numbers: Frame(from_vector(numbers[3:]), [1e3 * value for value in numbers[:3]]),
        lambda frame: [*(1e-3 * value for value in frame.position_mm), *to_vector(frame.rotation)],
        *(math.degrees(1.0), 7, (7, 7, 7, 8, 8, 8)),
    ),
    Controller.fanuc: Language(
        tp,
        tp_frames,
        lambda numbers: _of_angles(numbers, (0, 1, 2)),  # W, P, R: about x, y, z
        lambda frame: [*frame.position_mm, *_angles_of(frame)],
        *(1.0, 3, (3, 3, 3, 3, 3, 3)),
    ),
}
_SUFFIXES = {
    **dict.fromkeys((".dat", ".src"), Controller.kuka),
    **dict.fromkeys((".mod", ".modx", ".sys", ".sysx"), Controller.abb),
    **dict.fromkeys((".script", ".urscript"), Controller.ur),
    ".ls": Controller.fanuc,
}
