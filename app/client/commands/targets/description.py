"""Options that describe a target."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Annotated

import typer

from ... import Json


class Kind(enum.StrEnum):
    """Kinds of targets."""

    chessboard = "chessboard"
    charuco = "charuco"
    circles = "circles"
    asymmetric_circles = "asymmetric_circles"
    aprilgrid = "aprilgrid"


class KindOfPrint(enum.StrEnum):
    """How a target was made."""

    paper = "paper"
    plate = "plate"
    glass = "glass"


PitchSigma = Annotated[
    float | None,
    typer.Option(help="Standard uncertainty of the pitch, mm, common to the whole print.", min=0.0),
]
PrintKind = Annotated[
    KindOfPrint | None,
    typer.Option(help="How it was made: paper on a board, ink on a rigid plate, or chrome on glass."),
]


@dataclass(frozen=True, slots=True, kw_only=True)
class TargetDescription:
    """The options that describe a target; None where not given."""

    kind: Annotated[Kind | None, typer.Option(help="Kind of the printed target.")] = None
    columns: Annotated[
        int | None, typer.Option(help="Grid points along x: inner corners, dots, or tags.", min=2, max=500)
    ] = None
    rows: Annotated[int | None, typer.Option(help="Grid points along y.", min=2, max=500)] = None
    pitch_mm: Annotated[float | None, typer.Option(help="Distance of neighbouring grid points.")] = None
    marker_mm: Annotated[float | None, typer.Option(help="Side of a marker or tag; diameter of a dot.")] = (
        None
    )
    dictionary: Annotated[
        str | None, typer.Option(help="Of a ChArUco board's markers, by OpenCV's name, e.g. DICT_5X5_100.")
    ] = None
    legacy_layout: Annotated[
        bool, typer.Option("--legacy-layout", help="ChArUco layout of OpenCV before 4.6.")
    ] = False

    def fields(self) -> Json:
        """Return the given fields under the API's names."""
        values: Json = {
            "kind": None if self.kind is None else str(self.kind),
            "columns": self.columns,
            "rows": self.rows,
            "pitch_mm": self.pitch_mm,
            "marker_mm": self.marker_mm,
            "dictionary": self.dictionary,
            "legacy_layout": self.legacy_layout or None,
        }
        return {name: value for name, value in values.items() if value is not None}

    @property
    def given(self) -> list[str]:
        """The names of the given options."""
        return [f"--{name.replace('_', '-')}" for name in self.fields()]
