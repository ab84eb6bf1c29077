"""How each controller's programs write a point: where its numbers stand, and what they mean.

Sources: KUKA System Software, Operating and Programming Instructions (E6POS, E6AXIS); ABB, Technical reference manual
RAPID (robtarget, jointtarget, orient); Universal Robots, The URScript Programming Language (poses); FANUC, ASCII
listings of TP programs (/POS).
"""

from __future__ import annotations

import enum
import math
import re
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

Span = tuple[int, int]
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_FLAGS = re.IGNORECASE | re.MULTILINE


class Controller(enum.StrEnum):
    """Makes of controllers whose programs can be read and written."""

    kuka = "kuka"
    abb = "abb"
    ur = "ur"
    fanuc = "fanuc"


@dataclass(frozen=True, slots=True)
class Found:
    """A point in a program's text: where it begins, its name, and where its numbers stand; none: it is not whole."""

    start: int
    name: str
    joints: bool
    spans: tuple[Span, ...] | None


@dataclass(frozen=True, slots=True)
class Language:
    """The points of one controller's programs.

    Parameters
    ----------
    find
        The points of a text.
    frame_of, numbers_of
        Between the numbers of a Cartesian point and its frame.
    degrees
        In one unit of a joint angle.
    decimals
        Of a joint angle, and of each number of a Cartesian point.
    """

    find: Callable[[str], Iterator[Found]]
    frame_of: Callable[[Sequence[float]], Frame]
    numbers_of: Callable[[Frame], Sequence[float]]
    degrees: float
    joint_decimals: int
    decimals: tuple[int, ...]


def controller_of(path: PurePath) -> Controller | None:
    """Return the controller whose programs have such a name; None for a table."""
    return _SUFFIXES.get(path.suffix.lower())


def _named(text: str, start: int, end: int, names: Sequence[str], separator: str) -> tuple[Span, ...] | None:
    """Return where text[start:end] has the numbers of the named fields; None where one is missing."""
    spans = []
    for name in names:
        pattern = re.compile(rf"(?<![\w$]){name}{separator}({NUMBER})", _FLAGS)
        match = pattern.search(text, start, end)
        if match is None:
            return None
        spans.append(match.span(1))
    return tuple(spans)


def _listed(text: str, start: int, end: int, count: int | None) -> tuple[Span, ...] | None:
    """Return where a list's numbers stand; None where it has others, or another number of them."""
    numbers = list(re.finditer(NUMBER, text[start:end]))
    rest = re.sub(NUMBER, "", text[start:end])
    if rest.strip(" \t\r\n,") or (count is not None and len(numbers) != count):
        return None
    return tuple((start + one.start(), start + one.end()) for one in numbers)


_AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
_KRL = re.compile(
    r"(?:\b(?P<type>E6POS|POS|E6AXIS|AXIS)[ \t]+(?P<name>[\w$]+(?:\[\d+\])?)[ \t]*=[ \t]*"
    r"|\b(?:S?PTP|S?LIN|S?CIRC)[ \t]+)"
    r"\{(?:[ \t]*(?:E6POS|POS|E6AXIS|AXIS)[ \t]*:)?(?P<body>[^{}]*)\}",
    _FLAGS,
)


def _krl(text: str) -> Iterator[Found]:
    for match in _KRL.finditer(text):
        start, end = match.span("body")
        axes = re.search(r"(?<![\w$])A[1-6]\s", match["body"], _FLAGS) is not None
        names = _AXES if axes else ("X", "Y", "Z", "A", "B", "C")
        spans = _named(text, start, end, names, r"[ \t]+")
        yield Found(match.start(), match["name"] or "", axes, spans)


_RAPID = re.compile(
    r"\b(?P<type>robtarget|jointtarget)[ \t]+(?P<name>\w+)(?P<array>[ \t]*\{[^}]*\})?[ \t]*:=\s*\[", _FLAGS
)
_PART = r"\s*\[([^\[\]]*)\]\s*"


def _rapid(text: str) -> Iterator[Found]:
    for match in _RAPID.finditer(text):
        joints = match["type"].lower() == "jointtarget"
        spans: tuple[Span, ...] | None = None
        parts = re.compile(_PART if joints else f"{_PART},{_PART}").match(text, match.end())
        if parts is not None and match["array"] is None:
            counts = (6,) if joints else (3, 4)
            lists = [_listed(text, *parts.span(i + 1), count) for i, count in enumerate(counts)]
            if all(one is not None for one in lists):
                spans = tuple(span for one in lists if one is not None for span in one)
        yield Found(match.start(), match["name"], joints, spans)


_URSCRIPT = re.compile(
    r"(?:(?P<name>\b[A-Za-z_]\w*)[ \t]*=[ \t]*"
    r"|\b(?:movej|movel|movep|movec|servoj|get_inverse_kin)[ \t]*\([ \t]*|(?<=\]),[ \t]*(?=p\[))"
    r"(?P<pose>p?)\[(?P<body>[^\[\]]*)\]",
    _FLAGS,
)


_UR_MOVES = re.compile(r"\b(?:movej|movel|movep|movec|servoj|servoc|get_inverse_kin)[ \t]*\([^\r\n]*", _FLAGS)


def _urscript(text: str) -> Iterator[Found]:
    taken = {name for moves in _UR_MOVES.findall(text) for name in re.findall(r"[A-Za-z_]\w*", moves)}
    for match in _URSCRIPT.finditer(text):
        spans, is_joints = _listed(text, *match.span("body"), 6), not match["pose"]
        if is_joints and spans is None:
            continue
        # Speeds, forces and limits are six numbers, too: joint angles are those that a move takes.
        if is_joints and match["name"] and match["name"] not in taken:
            spans = None
        yield Found(match.start(), match["name"] or "", is_joints, spans)


_TP = re.compile(r"^[ \t]*P\[(?P<number>\d+)(?:[ \t]*:[ \t]*\"(?P<name>[^\"]*)\")?[^\]]*\][ \t]*\{", _FLAGS)
_POSITIONS = re.compile(r"^[ \t]*/POS\b", _FLAGS)


def _tp(text: str) -> Iterator[Found]:
    section = _POSITIONS.search(text)
    for match in _TP.finditer(text, section.end() if section else len(text)):
        end = text.find("}", match.end())
        end = len(text) if end < 0 else end
        joints = re.search(r"\bJ1\s*=", text[match.end() : end]) is not None
        names = [f"J{i}" for i in range(1, 7)] if joints else ("X", "Y", "Z", "W", "P", "R")
        spans = _named(text, match.end(), end, names, r"[ \t]*=(?=[ \t]*[-+.\d])[ \t]*")
        yield Found(match.start(), f"P{match['number']}", joints, spans)


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
        _krl,
        lambda numbers: _of_angles(numbers, (2, 1, 0)),  # A, B, C: about z, y, x
        lambda frame: [*frame.position_mm, *reversed(_angles_of(frame))],
        *(1.0, 5, (4, 4, 4, 5, 5, 5)),
    ),
    Controller.abb: Language(_rapid, _of_quaternion, _quaternion_of, 1.0, 5, (4, 4, 4, 9, 9, 9, 9)),
    Controller.ur: Language(
        _urscript,
        lambda numbers: Frame(from_vector(numbers[3:]), [1e3 * value for value in numbers[:3]]),
        lambda frame: [*(1e-3 * value for value in frame.position_mm), *to_vector(frame.rotation)],
        *(math.degrees(1.0), 7, (7, 7, 7, 8, 8, 8)),
    ),
    Controller.fanuc: Language(
        _tp,
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
