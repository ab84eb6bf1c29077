"""Where a program's text has its points, and where the numbers of each stand.

A point is found where the program states it: as a declared or assigned value, or in the move itself. One that is not
whole, or whose frame is another's, is found without numbers, so that its line can be named. Frames are no points.

Sources: KUKA System Software, Operating and Programming Instructions (E6POS, E6AXIS); ABB, Technical reference manual
RAPID (robtarget, jointtarget, orient); Universal Robots, The URScript Programming Language (poses); FANUC, ASCII
listings of TP programs (/POS).
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

Span = tuple[int, int]
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
FLAGS = re.IGNORECASE | re.MULTILINE


@dataclass(frozen=True, slots=True)
class Found:
    """A point in a program's text: where it begins, its name, and where its numbers stand; none: it is not whole."""

    start: int
    name: str
    joints: bool
    spans: tuple[Span, ...] | None


def code_of(text: str, comment: str) -> str:
    """Return the text with spaces in place of strings and of comments, which the sign begins."""
    return re.sub(rf'"[^"\r\n]*"|{comment}[^\r\n]*', lambda match: " " * len(match[0]), text)


def _named(text: str, start: int, end: int, names: Sequence[str], separator: str) -> tuple[Span, ...] | None:
    """Return where text[start:end] has the numbers of the named fields; None where one is missing."""
    spans = []
    for name in names:
        pattern = re.compile(rf"(?<![\w$]){name}{separator}({NUMBER})", FLAGS)
        match = pattern.search(text, start, end)
        if match is None:
            return None
        spans.append(match.span(1))
    return tuple(spans)


def _listed(text: str, start: int, end: int, count: int) -> tuple[Span, ...] | None:
    """Return where a list's numbers stand; None where it has others, or another number of them."""
    numbers = list(re.finditer(NUMBER, text[start:end]))
    rest = re.sub(NUMBER, "", text[start:end])
    if rest.strip(" \t\r\n,") or len(numbers) != count:
        return None
    return tuple((start + one.start(), start + one.end()) for one in numbers)


_AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
_KRL = re.compile(
    r"(?:(?:\b(?P<type>[a-z]\w*)[ \t]+)?(?<![\w$.])(?P<name>[a-z]\w*(?:\[\d+\])?)[ \t]*=[ \t]*"
    r"|\bS?(?:PTP|LIN|CIRC)[ \t]+|(?<=\})[ \t]*,[ \t]*)"
    r"\{(?:[ \t]*(?P<inner>\w+)[ \t]*:)?(?P<body>[^{}]*)\}(?P<operator>[ \t]*:)?",
    FLAGS,
)
_KRL_POINTS = frozenset({"E6POS", "POS", "E6AXIS", "AXIS"})


def krl(text: str) -> Iterator[Found]:
    """Find the points of a KUKA's .src or .dat; S and T make a value that is assigned a point, not a frame."""
    code = code_of(text, ";")
    for match in _KRL.finditer(code):
        start, end = match.span("body")
        kinds = {kind.upper() for kind in (match["type"], match["inner"]) if kind}
        axes = re.search(r"(?<![\w$])A[1-6]\s", match["body"], FLAGS) is not None
        if not kinds <= _KRL_POINTS or not (axes or re.search(r"(?<![\w$])[XYZ]\s", match["body"], FLAGS)):
            continue
        spans = _named(code, start, end, _AXES if axes else ("X", "Y", "Z", "A", "B", "C"), r"[ \t]+")
        is_frame = (
            match["name"] and not kinds and not axes and not re.search(r"\b[ST]\s", match["body"], FLAGS)
        )
        if is_frame or match["operator"]:
            spans = None
        yield Found(match.start(), match["name"] or "", axes, spans)


_PART = r"\s*\[([^\[\]]*)\]\s*"
_RAPID = re.compile(
    r"\b(?:robtarget|jointtarget)[ \t]+(?P<array>\w+)[ \t]*\{[^}]*\}[ \t]*:=[^;]*"
    rf"|(?:(?P<name>\w+)[ \t]*:=[ \t]*)?\[(?P<parts>{_PART},{_PART}(?:,{_PART},{_PART})?)\]",
    FLAGS,
)
_TARGET, _JOINTTARGET, _POSE = 4, 6, 3


def rapid(text: str) -> Iterator[Found]:
    """Find the targets of an ABB's module by their form: [position, quaternion, configuration, external axes], or
    [axes, external axes].
    """
    code = code_of(text, "!")
    for match in _RAPID.finditer(code):
        if match["array"]:
            yield Found(match.start(), match["array"], False, None)
            continue
        groups = [
            i for i in range(match.re.groups - _TARGET + 1, match.re.groups + 1) if match[i] is not None
        ]
        joints = len(groups) < _TARGET
        if joints and match[groups[0]].count(",") != _JOINTTARGET - 1:
            continue  # a frame, or a tool's
        counts = (_JOINTTARGET,) if joints else (_POSE, _TARGET)
        lists = [_listed(code, *match.span(i), count) for i, count in zip(groups, counts, strict=False)]
        whole = [one for one in lists if one is not None]
        spans = tuple(span for one in whole for span in one) if len(whole) == len(lists) else None
        yield Found(match.start(), match["name"] or "", joints, spans)


_UR_MOVES = frozenset({"movej", "movel", "movep", "movec", "servoj", "servoc", "get_inverse_kin"})
_URSCRIPT = re.compile(
    r"(?:(?P<name>\b[a-z_]\w*)[ \t]*=[ \t]*)?(?<!\w)(?P<pose>p?)\[(?P<body>[^\[\]]*)\]", FLAGS
)
_CALL = re.compile(r"(\w*)[ \t]*\(|\)|[\r\n]")


def urscript(text: str) -> Iterator[Found]:
    """Find the poses and joint angles that a move takes, as they are or by a name.

    What another function turns or moves first is in another frame, or an offset; it is not whole, like a pose that no
    move takes. Speeds, forces and limits are six numbers, too.
    """
    code = code_of(text, "#")
    calls = _Calls(code)
    words = re.finditer(r"[A-Za-z_]\w*", code)
    taken = {word[0] for word in words if calls.innermost(word.start()) in _UR_MOVES}
    for match in _URSCRIPT.finditer(code):
        joints, function = not match["pose"], calls.innermost(match.start())
        in_move = function in _UR_MOVES
        name = "" if function else match["name"] or ""  # in a call it is an option's: qnear=[...]
        spans = _listed(code, *match.span("body"), 6)
        if joints and not in_move and (spans is None or not name):
            continue
        if function and not in_move and "pose" not in function:
            continue  # a frame that a function is given
        if not in_move and name not in taken:
            spans = None
        yield Found(match.start(), name, joints, spans)


class _Calls:
    """The function whose arguments a place of a script is among; a call ends with its line."""

    def __init__(self, code: str) -> None:
        self._ends, self._of = [0], list[tuple[str, ...]]([()])
        for match in _CALL.finditer(code):
            inside: tuple[str, ...] = ()
            if match[0] == ")":
                inside = self._of[-1][:-1]
            elif match[1] is not None:
                inside = (*self._of[-1], match[1].lower())
            self._ends.append(match.end())
            self._of.append(inside)

    def innermost(self, place: int) -> str:
        inside = self._of[bisect_right(self._ends, place) - 1]
        return inside[-1] if inside else ""


_TP = re.compile(r"^[ \t]*P\[(?P<number>\d+)(?:[ \t]*:[ \t]*\"(?P<name>[^\"]*)\")?[^\]]*\][ \t]*\{", FLAGS)
_POSITIONS = re.compile(r"^[ \t]*/POS\b", FLAGS)
_GROUP = re.compile(r"\bGP(\d+)[ \t]*:", FLAGS)


def tp(text: str) -> Iterator[Found]:
    """Find the positions of a FANUC's listing; of several groups of axes the first is the robot."""
    section = _POSITIONS.search(text)
    for match in _TP.finditer(text, section.end() if section else len(text)):
        start, end = match.end(), text.find("}", match.end())
        end = len(text) if end < 0 else end
        for group in _GROUP.finditer(text, start, end):
            if group[1] != "1":
                end = group.start()
                break
        joints = re.search(r"\bJ1\s*=", text[start:end]) is not None
        names = [f"J{i}" for i in range(1, 7)] if joints else ("X", "Y", "Z", "W", "P", "R")
        spans = _named(text, start, end, names, r"[ \t]*=(?=[ \t]*[-+.\d])[ \t]*")
        yield Found(match.start(), f"P{match['number']}", joints, spans)
