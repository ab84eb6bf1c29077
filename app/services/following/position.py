"""A position among the changes of a session: the change that a follower saw last."""

from __future__ import annotations

import re
from dataclasses import dataclass

from app.records.ids import is_id

_SHAPE = re.compile(r"([0-9]{1,16})-(.*)")


@dataclass(frozen=True, slots=True)
class Position:
    """A place in the order of `tables.MeasurementChange`: after this change of this measurement."""

    number: int
    measurement_id: str

    def __str__(self) -> str:
        return f"{self.number}-{self.measurement_id}"


BEGINNING = Position(0, "")
"""Before every change."""


def parse_position(text: str) -> Position | None:
    """Return the position that a text states, None for a text that states none."""
    found = _SHAPE.fullmatch(text)
    if found is None or not (found[2] == "" or is_id(found[2])):
        return None
    return Position(int(found[1]), found[2])
