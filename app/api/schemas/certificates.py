"""What is known of a print as JSON: its certificate, and the uncertainty of its shape."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.common import MAX_LENGTH_MM, RequestModel, Text

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
        Annotated[str, Field(pattern=r"^[0-9]{4}-[01][0-9]-[0-3][0-9]$")] | None,
        Field(description="Day of issue, YYYY-MM-DD; null: not known.", examples=["2026-03-14"]),
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
