"""Targets as JSON."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.common import (
    MAX_LENGTH_MM,
    PositiveLength,
    RequestModel,
    ResponseModel,
    StoredPage,
    Text,
)
from app.api.schemas.fields import TargetId

Length = Annotated[float, Field(gt=0.0, le=MAX_LENGTH_MM)]
Uncertainty = Annotated[float, Field(ge=0.0, le=MAX_LENGTH_MM)]
Coordinate = Annotated[float, Field(ge=-MAX_LENGTH_MM, le=MAX_LENGTH_MM)]
GridPoint = Annotated[list[Coordinate], Field(min_length=3, max_length=3)]

PrintKind = TypeAliasType(
    "PrintKind",
    Annotated[
        Literal["paper", "plate", "glass"],
        Field(
            description="How a target was made, which says how far it may depart from its grid: `paper` glued to a "
            "board, ink on a rigid `plate`, chrome on `glass`."
        ),
    ],
)


class CertificateUncertainty(RequestModel):
    """Standard uncertainties of a certificate's pitches and squareness."""

    pitch_x_mm: Annotated[Uncertainty, Field(description="Of the pitch along x, mm.", examples=[0.001])]
    pitch_y_mm: Annotated[Uncertainty, Field(description="Of the pitch along y, mm.", examples=[0.001])]
    squareness_mrad: Annotated[
        float, Field(ge=0.0, le=100.0, description="Of the squareness, mrad.", examples=[0.02])
    ] = 0.0


class Certificate(RequestModel):
    """What a laboratory measured of one target: both pitches and the squareness, or every grid point.

    It takes the place of the nominal grid in every analysis.
    """

    number: Annotated[Text | None, Field(description="The certificate's number; null: none.")] = None
    laboratory: Annotated[Text | None, Field(description="Who issued it; null: not known.")] = None
    issued_on: Annotated[
        Annotated[
            str, Field(pattern=r"^[0-9]{4}-[01][0-9]-[0-3][0-9]$", json_schema_extra={"format": "date"})
        ]
        | None,
        Field(
            description="Day of issue, YYYY-MM-DD, not after today; null: not known.", examples=["2026-03-14"]
        ),
    ] = None
    temperature_c: Annotated[
        Annotated[float, Field(ge=-100.0, le=200.0)] | None,
        Field(description="Temperature at which its lengths hold, °C. With `expansion_per_k`, or null."),
    ] = None
    expansion_per_k: Annotated[
        Annotated[float, Field(ge=-1e-3, le=1e-3)] | None,
        Field(
            description="Relative expansion of the board a kelvin, such as 8.5e-6 of glass: takes its lengths to the "
            "session's `conditions.temperature_c` where that is stated. Null: lengths are used as they are.",
            examples=[8.5e-6],
        ),
    ] = None
    pitch_x_mm: Annotated[
        Length | None,
        Field(description="Distance of neighbouring grid points along x, mm. With `pitch_y_mm`."),
    ] = None
    pitch_y_mm: Annotated[
        Length | None, Field(description="Distance of neighbouring grid points along y, mm.")
    ] = None
    squareness_mrad: Annotated[
        Annotated[float, Field(ge=-100.0, le=100.0)] | None,
        Field(description="By how much less than 90° the axes meet, mrad; null: 0."),
    ] = None
    standard_uncertainty: Annotated[
        CertificateUncertainty | None, Field(description="Of pitches and squareness; needed with pitches.")
    ] = None
    points_mm: Annotated[
        Annotated[list[GridPoint], Field(max_length=100_000)] | None,
        Field(
            description="Every grid point [x, y, z], row by row, in the target frame, mm; null: the pitches count.",
            examples=[None],
        ),
    ] = None
    points_standard_uncertainty_mm: Annotated[
        Uncertainty | None,
        Field(description="Standard uncertainty of a point along each axis, mm; needed with `points_mm`."),
    ] = None


class StatedShapeUncertainty(RequestModel):
    """Standard uncertainties of a print's departures from its grid, in place of those of its kind."""

    aspect: Annotated[
        float, Field(ge=0.0, le=0.1, description="Of the length along x over that along y.")
    ] = 5e-4
    shear: Annotated[float, Field(ge=0.0, le=0.1, description="Of the angle of the axes, rad.")] = 5e-4
    bow_mm: Annotated[
        float, Field(ge=0.0, le=100.0, description="Of the border's height over the middle, mm.")
    ] = 0.1
    twist_mm: Annotated[
        float, Field(ge=0.0, le=100.0, description="Of the corners' height, two up and two down, mm.")
    ] = 0.1
    quadratic_mm: Annotated[
        float, Field(ge=0.0, le=100.0, description="Of the border's quadratic departure in the plane, mm.")
    ] = 0.02
    point_mm: Annotated[
        float, Field(ge=0.0, le=100.0, description="Of each grid point by itself, along x and y, mm.")
    ] = 0.01


Span = Annotated[int, Field(ge=2, le=500)]
Pitch = Annotated[
    float, Field(ge=1e-6, le=MAX_LENGTH_MM)
]  # a nanometre: a smaller one is a slip, and squares to nothing


_KIND = (
    "`chessboard`, `charuco` (a chessboard with markers), `circles` (dots in rows and columns), `asymmetric_circles` "
    "(every other row of dots shifted by a pitch), `aprilgrid` (Kalibr's tags)."
)
_COLUMNS = (
    "Grid points along x: inner corners of a chessboard or ChArUco board, dots of circles; tags of an AprilGrid. "
    "At least 2 tags of an AprilGrid, and 3 grid points of the other kinds."
)
_ROWS = "Grid points along y, counted as `columns` are."
_PITCH = (
    "Nominal distance of neighbouring grid points, mm: a square's side, dot to dot, tag to tag. Asymmetric circles lie "
    "at x = (2 column + row mod 2) pitch, y = row times pitch."
)
_MARKER = (
    "Side of a ChArUco marker or of an AprilGrid tag, or diameter of a dot, mm; less than the pitch. Null: the "
    "kind has "
    "none, or half the distance of dots."
)
_DICTIONARY = (
    "OpenCV's name of the markers' dictionary, such as `DICT_5X5_100`. Null: none; an AprilGrid is 36h11."
)
_LEGACY = "ChArUco boards of OpenCV before 4.6 with an even number of rows of squares, which begin with a white square."
_PITCH_UNCERTAINTY = (
    "Standard uncertainty of the pitch, mm, common to the whole print: it scales every absolute length. Null: the "
    "pitch is taken as exact."
)

_PRINT_KIND = "How the target was made. Null: as `paper`."
_SHAPE = (
    "How far the print may depart from its grid, for the uncertainty of absolute figures. Null: as its kind of print "
    "lets expect (docs/uncertainty.md)."
)
_CERTIFICATE = (
    "Where the grid points were measured to lie, in place of the nominal grid. Null: no certificate."
)

TargetKind = TypeAliasType(
    "TargetKind",
    Annotated[
        Literal["chessboard", "charuco", "circles", "asymmetric_circles", "aprilgrid"],
        Field(description="What a printed target shows."),
    ],
)


class TargetCreate(RequestModel):
    """A printed target."""

    name: Annotated[
        Text,
        Field(
            description="What people call the target; need not be unique.", examples=["Glass board 14 x 10"]
        ),
    ]
    kind: Annotated[TargetKind, Field(description=_KIND)]
    columns: Annotated[Span, Field(description=_COLUMNS)]
    rows: Annotated[Span, Field(description=_ROWS)]
    pitch_mm: Annotated[Pitch, Field(description=_PITCH)]
    marker_mm: Annotated[PositiveLength | None, Field(description=_MARKER)] = None
    dictionary: Annotated[
        Annotated[str, Field(max_length=64, pattern=r"^[A-Za-z0-9_]+$")] | None,
        Field(description=_DICTIONARY),
    ] = None
    legacy_layout: Annotated[bool, Field(description=_LEGACY)] = False
    pitch_standard_uncertainty_mm: Annotated[
        Annotated[float, Field(ge=0, le=1e6)] | None, Field(description=_PITCH_UNCERTAINTY)
    ] = None
    print_kind: Annotated[PrintKind | None, Field(description=_PRINT_KIND)] = None
    shape_standard_uncertainty: Annotated[StatedShapeUncertainty | None, Field(description=_SHAPE)] = None
    certificate: Annotated[Certificate | None, Field(description=_CERTIFICATE)] = None


class TargetChange(RequestModel):
    """What to change of a target; fields left away stay as they are."""

    # The factory makes the field optional without allowing null; what was not sent is never looked at.
    name: Annotated[Text, Field(description="What people call the target.", default_factory=str)]
    pitch_standard_uncertainty_mm: Annotated[
        Annotated[float, Field(ge=0, le=1e6)] | None, Field(description=_PITCH_UNCERTAINTY)
    ] = None
    print_kind: Annotated[PrintKind | None, Field(description=_PRINT_KIND)] = None
    shape_standard_uncertainty: Annotated[StatedShapeUncertainty | None, Field(description=_SHAPE)] = None
    certificate: Annotated[Certificate | None, Field(description=_CERTIFICATE)] = None


class TargetRead(ResponseModel):
    """A printed target as stored."""

    id: TargetId
    name: Annotated[str, Field(description="What people call the target.")]
    kind: Annotated[TargetKind, Field(description=_KIND)]
    columns: Annotated[int, Field(description=_COLUMNS)]
    rows: Annotated[int, Field(description=_ROWS)]
    pitch_mm: Annotated[float, Field(description=_PITCH)]
    marker_mm: Annotated[float | None, Field(description=_MARKER)]
    dictionary: Annotated[str | None, Field(description=_DICTIONARY)]
    legacy_layout: Annotated[bool, Field(description=_LEGACY)]
    pitch_standard_uncertainty_mm: Annotated[float | None, Field(description=_PITCH_UNCERTAINTY)]
    print_kind: Annotated[PrintKind | None, Field(description=_PRINT_KIND)]
    shape_standard_uncertainty: Annotated[StatedShapeUncertainty | None, Field(description=_SHAPE)]
    certificate: Annotated[Certificate | None, Field(description=_CERTIFICATE)]
    created_at: Annotated[datetime, Field(description="When the target was made, RFC 3339 in UTC.")]


class TargetPage(StoredPage):
    """One page of targets."""

    items: Annotated[list[TargetRead], Field(description="Targets, oldest first.")]
