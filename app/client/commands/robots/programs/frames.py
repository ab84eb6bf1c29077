"""The frames that a program names for its Cartesian points: bases and tools by its own names.

One base and one tool are given for a whole file. Where its points are in several, most of them are not in these.

Sources: as of `points`; of KUKA also inline forms, whose point XP1 has its frames in FP1 (FDAT); of ABB the last
argument of a move, and its \\WObj.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable

from .points import FLAGS, Found, code_of

FramesOf = Callable[[str, Iterable[Found]], set[str]]
"""The frames of a text with these points."""

_FDAT = re.compile(r"\bFDAT[ \t]+F(?P<point>\w+)[ \t]*=[ \t]*\{(?P<body>[^{}]*)\}", FLAGS)
_SYSTEM = re.compile(r"(?P<name>\$(?:BASE|TOOL))[ \t]*=[ \t]*(?P<value>[^\r\n]*\S)", FLAGS)
_NUMBERS = ("TOOL_NO", "BASE_NO")


def krl_frames(text: str, points: Iterable[Found]) -> set[str]:
    """Return tool and base by the points' inline forms; else the values of $BASE and $TOOL, which the program sets."""
    code = code_of(text, ";")
    stated = {}
    for match in _FDAT.finditer(code):
        numbers = [re.search(rf"\b{name}[ \t]+(\d+)", match["body"], FLAGS) for name in _NUMBERS]
        stated[match["point"].upper()] = ", ".join(number[0].upper() for number in numbers if number)
    forms = {stated.get(point.name[1:].upper(), "") for point in points if not point.joints} - {""}
    return forms or _if_several(
        f"{match['name'].upper()}={_packed(match['value']).upper()}" for match in _SYSTEM.finditer(code)
    )


def _packed(text: str) -> str:
    """Return a text without its spaces."""
    return "".join(text.split())


def _if_several(settings: Iterable[str]) -> set[str]:
    """Return the settings of each name that a program sets to more than one value."""
    found = set(settings)
    values = Counter(setting.split("=")[0] for setting in found)
    return {setting for setting in found if values[setting.split("=")[0]] > 1}


_MOVE = re.compile(r"\b(?:Move|Arc|Spot|Search|Trigg)(?:L|J|C)\w*\b(?P<arguments>[^;]*);", FLAGS)
_OPTION = re.compile(r"\\\s*(?P<name>\w+)(?:\s*:=\s*(?P<value>[^\\,;\s]+))?", FLAGS)


def rapid_frames(text: str, points: Iterable[Found]) -> set[str]:
    """Return tool and work object of the moves."""
    found = set()
    for move in _MOVE.finditer(code_of(text, "!")):
        tool = re.search(r"(\w+)\s*$", _OPTION.sub(" ", move["arguments"]))
        objects = [
            one["value"] for one in _OPTION.finditer(move["arguments"]) if one["name"].lower() == "wobj"
        ]
        if tool is not None:
            found.add(f"{tool[1]}, {(objects or ['wobj0'])[0]}".lower())
    return found


_TCP = re.compile(r"\bset_tcp[ \t]*\((?P<tool>[^()\r\n]*)\)", FLAGS)


def urscript_frames(text: str, points: Iterable[Found]) -> set[str]:
    """Return the tools that the script sets."""
    return {f"set_tcp({_packed(match['tool'])})" for match in _TCP.finditer(code_of(text, "#"))}


_USER_FRAME = re.compile(r"\bUF[ \t]*:[ \t]*(\w+)[ \t]*,[ \t]*UT[ \t]*:[ \t]*(\w+)", FLAGS)


def tp_frames(text: str, points: Iterable[Found]) -> set[str]:
    """Return user frame and tool, which each position states."""
    stated = [
        _USER_FRAME.search(text, point.start, point.spans[0][0])
        for point in points
        if point.spans is not None and not point.joints
    ]
    return {f"UF {one[1]}, UT {one[2]}" for one in stated if one is not None}
