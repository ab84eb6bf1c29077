"""A robot program as its points: commands of the flange in the robot's base, and the text with others in their place.

Nothing but the numbers of points changes: comments, motions, tools, configurations and line ends stay byte by byte.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...console import OptionRefused
from ...rotations import Frame, from_roll_pitch_yaw, to_roll_pitch_yaw
from .languages import LANGUAGES, Controller, Language
from .points import Found

_ENCODING = "latin-1"
"""Each byte is a character: what the program says in another encoding returns as it was."""
_MIN_COLUMN_SPACES = 2
_NOT_IN_IDS = re.compile(r"[^A-Za-z0-9_-]+")


class ProgramRefused(OptionRefused):
    """A program whose points cannot be used."""


@dataclass(frozen=True, slots=True)
class Program:
    """A program and its points.

    Parameters
    ----------
    points
        By pose id, in the order of the text: a name of the program, or the line where it has none.
    base, tool
        T_base_program, the frame in which the program states its points, in the robot's base; and T_flange_tool.
    incomplete_lines
        Lines of points that are not whole, which stay as they are.
    """

    text: str
    language: Language
    points: Mapping[str, Found]
    base: Frame
    tool: Frame
    incomplete_lines: tuple[int, ...]

    @property
    def has_cartesian_points(self) -> bool:
        """Whether frames matter."""
        return any(not point.joints for point in self.points.values())

    @property
    def frames(self) -> set[str]:
        """The frames that the program names for its points; one base and one tool are right for one of them."""
        return self.language.frames(self.text, self.points.values()) if self.has_cartesian_points else set()

    def commands(self) -> list[dict[str, Any]]:
        """Return the points with the fields of the API: joint angles, or the flange in the robot's base."""
        return [{"pose_id": name, **self._command(point)} for name, point in self.points.items()]

    def with_commands(self, commands: Mapping[str, Mapping[str, Any]]) -> bytes:
        """Return the program's bytes with the numbers of the points that `commands` has, by pose id."""
        pieces, end = [], 0
        for name, point in self.points.items():
            if name in commands and point.spans is not None:
                for (start, stop), number in zip(
                    point.spans, self._numbers(point, commands[name]), strict=True
                ):
                    pieces += [self._before(end, start, len(number) - (stop - start)), number]
                    end = stop
        return "".join([*pieces, self.text[end:]]).encode(_ENCODING)

    def _before(self, end: int, start: int, longer: int) -> str:
        """Return the text before a number; a column of numbers stays aligned to the right."""
        text = self.text[end:start]
        spaces = len(text) - len(text.rstrip(" "))
        if spaces < _MIN_COLUMN_SPACES:
            return text
        return text + " " * -longer if longer < 0 else text[: len(text) - min(longer, spaces - 1)]

    def _command(self, point: Found) -> dict[str, Any]:
        numbers = [float(self.text[start:stop]) for start, stop in point.spans or ()]
        if point.joints:
            return {"joint_angles_deg": [self.language.degrees * number for number in numbers]}
        try:
            T = self.base @ self.language.frame_of(numbers) @ self.tool.inverse()
        except ValueError as error:
            raise ProgramRefused(f"In line {_line(self.text, point.start)}: {error}.") from error
        roll, pitch, yaw = map(math.degrees, to_roll_pitch_yaw(T.rotation))
        return {"position_mm": T.position_mm, "roll_deg": roll, "pitch_deg": pitch, "yaw_deg": yaw}

    def _numbers(self, point: Found, command: Mapping[str, Any]) -> list[str]:
        language = self.language
        if point.joints:
            angles = [angle / language.degrees for angle in command["joint_angles_deg"]]
            return [f"{angle:.{language.joint_decimals}f}" for angle in angles]
        angles = [math.radians(command[name]) for name in ("roll_deg", "pitch_deg", "yaw_deg")]
        flange = Frame(from_roll_pitch_yaw(*angles), list(command["position_mm"]))
        numbers = language.numbers_of(self.base.inverse() @ flange @ self.tool)
        return [f"{number:.{places}f}" for number, places in zip(numbers, language.decimals, strict=True)]


def read_program(path: Path, controller: Controller, base: Frame, tool: Frame) -> Program:
    """Return the points of a program's file. Raises ProgramRefused."""
    try:
        text = path.read_bytes().decode(_ENCODING)
    except OSError as error:
        raise ProgramRefused(f"{path} cannot be read: {error.strerror}.") from error
    language = LANGUAGES[controller]
    points: dict[str, Found] = {}
    counts: Counter[str] = Counter()
    incomplete, line, end = [], 1, 0
    for found in language.find(text):
        line, end = line + text.count("\n", end, found.start), found.start
        if found.spans is None:
            incomplete.append(line)
            continue
        name = _NOT_IN_IDS.sub("_", found.name).strip("_") or f"line_{line}"
        counts[name] += 1
        points[name if counts[name] == 1 else f"{name}--{counts[name]}"] = found
    if not points:
        raise ProgramRefused(
            f"{path.name} holds no points of a program of {controller}.",
            "Give --controller where the file is of another make.",
        )
    return Program(text, language, points, base, tool, tuple(dict.fromkeys(incomplete)))


def _line(text: str, place: int) -> int:
    return text.count("\n", 0, place) + 1
