"""What a printed target is, and where its grid points ideally lie."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from core.errors import Advisory, InvalidTarget
from core.targets.certificate import Certificate
from core.targets.quality_result import CaptureQuality
from core.targets.shape_uncertainty import PRINT_KINDS, ShapeUncertainty

KINDS = ("chessboard", "charuco", "circles", "asymmetric_circles", "aprilgrid")

Labelling = Literal["absolute", "up_to_symmetry"]
"""How far an image determines which grid point is (0, 0): uniquely, or but for turns of the whole grid that look the
same, one of which was chosen."""

MAX_CERTIFIED_DEPARTURE = 0.1
"""Of the pitch, by which certified points may lie off the nominal grid: what is further is another frame or unit."""


def target_of(fields: Mapping[str, Any]) -> TargetSpec:
    """Return the target with these fields, as JSON has them; `temperature_c`, if there is one, is that at which it is
    measured, to which its certificate is taken.

    Raises InvalidTarget.
    """
    values = dict(fields)
    temperature_c = values.pop("temperature_c", None)
    if values.get("shape_standard_uncertainty") is not None:
        values["shape_standard_uncertainty"] = ShapeUncertainty(**values["shape_standard_uncertainty"])
    if values.get("certificate") is not None:
        certificate = Certificate.of(values["certificate"])
        values["certificate"] = (
            certificate if temperature_c is None else certificate.at_temperature(temperature_c)
        )
    return TargetSpec(**values)


@dataclass(frozen=True, slots=True)
class TargetSpec:
    """A planar target.

    `columns`, `rows` count grid points along x and y (inner corners of a chessboard), or an AprilGrid's tags;
    `pitch_mm` is the distance of neighbouring ones. The target frame has its origin at grid point (0, 0), x along
    columns, y along rows, z = x × y (into the board when seen from the front with y down).

    An AprilGrid's grid points are its tags' corners: columns 2i and 2i + 1 are the two sides of its i-th tags along x,
    rows 2j and 2j + 1 those of its j-th ones along y (where that begins: `core.targets.aprilgrid.layout`).

    `print_kind`, one of `PRINT_KINDS`, says how far the print may depart from that grid, unless
    `shape_standard_uncertainty` does. A `certificate` takes the place of the nominal grid.
    """

    kind: str
    columns: int
    rows: int
    pitch_mm: float
    marker_mm: float | None = None
    dictionary: str | None = None
    legacy_layout: bool = False
    pitch_standard_uncertainty_mm: float | None = None
    print_kind: str | None = None
    shape_standard_uncertainty: ShapeUncertainty | None = None
    certificate: Certificate | None = None

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InvalidTarget(
                f"Unknown target kind {self.kind!r}.", f"Use one of {', '.join(KINDS)}.", field="kind"
            )
        for name in ("columns", "rows"):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or not 2 <= value <= 500:
                raise InvalidTarget(
                    f"{name} must be a whole number from 2 to 500, got {value!r}.", field=name
                )
        if not (math.isfinite(self.pitch_mm) and self.pitch_mm > 0):
            raise InvalidTarget(
                f"pitch_mm must be a positive length, got {self.pitch_mm!r}.", field="pitch_mm"
            )
        uncertainty = self.pitch_standard_uncertainty_mm
        if uncertainty is not None and not 0 <= uncertainty < self.pitch_mm:
            raise InvalidTarget(
                f"pitch_standard_uncertainty_mm must lie between 0 and the pitch, got {uncertainty!r}.",
                field="pitch_standard_uncertainty_mm",
            )
        if self.print_kind is not None and self.print_kind not in PRINT_KINDS:
            raise InvalidTarget(
                f"Unknown kind of print {self.print_kind!r}.",
                f"Use one of {', '.join(PRINT_KINDS)}.",
                field="print_kind",
            )
        self._check_certificate()

    def _check_certificate(self) -> None:
        certificate = self.certificate
        if certificate is None:
            return
        wrong = None
        if certificate.points_mm is not None and len(certificate.points_mm) != self.size:
            wrong = f"points_mm has {len(certificate.points_mm)} points, the target {self.size}."
        elif (
            float(np.max(np.abs(self.points_target() - self._ideal())))
            > MAX_CERTIFIED_DEPARTURE * self.pitch_mm
        ):
            wrong = "The certified points lie further than a tenth of a pitch from the nominal grid."
        if wrong is not None:
            raise InvalidTarget(
                wrong,
                "Give the points row by row in the target frame, origin at grid point (0, 0), x along columns, in mm.",
                field="certificate",
            )

    @property
    def scale_standard_uncertainty(self) -> float | None:
        """Relative standard uncertainty of the print's scale; None where neither certificate nor pitch states one."""
        stated = self.certificate
        if stated is None:
            uncertainty = self.pitch_standard_uncertainty_mm
            return None if uncertainty is None else uncertainty / self.pitch_mm
        if stated.points_mm is not None:
            extent = float(np.max(np.ptp(np.array(stated.points_mm), axis=0)))
            return (stated.points_standard_uncertainty_mm or 0.0) / extent
        assert stated.standard_uncertainty is not None  # of pitches there is one
        u = stated.standard_uncertainty
        return 0.5 * math.hypot(u.pitch_x_mm, u.pitch_y_mm) / self.pitch_mm

    @property
    def grid_columns(self) -> int:
        """Number of grid points along x."""
        return 2 * self.columns if self.kind == "aprilgrid" else self.columns

    @property
    def grid_rows(self) -> int:
        """Number of grid points along y."""
        return 2 * self.rows if self.kind == "aprilgrid" else self.rows

    @property
    def size(self) -> int:
        """Number of grid points of the whole target."""
        return self.grid_columns * self.grid_rows

    def outline(self) -> Float[np.ndarray, "4 3"]:
        """Return the corners of the grid with a pitch around it, mm."""
        points = self.points_target()[:, :2]
        low, high = points.min(axis=0) - self.pitch_mm, points.max(axis=0) + self.pitch_mm
        return np.array([[x, y, 0.0] for x in (low[0], high[0]) for y in (low[1], high[1])])

    def rows_and_columns(self) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
        """Return the row and the column of every grid point, row-major."""
        row, column = np.mgrid[0 : self.grid_rows, 0 : self.grid_columns]
        return row.ravel(), column.ravel()

    def points_target(
        self, column: Int[np.ndarray, " n"] | None = None, row: Int[np.ndarray, " n"] | None = None
    ) -> Float[np.ndarray, "n 3"]:
        """Return grid points in the target frame, mm; row-major over the whole target by default.

        The ideal ones, or those of the certificate.
        """
        if self.certificate is None:
            return self._ideal(column, row)
        everywhere = self.certificate.places(self._ideal(), self.pitch_mm)
        if column is None or row is None:
            return everywhere
        return np.ascontiguousarray(everywhere[row * self.grid_columns + column])

    def _ideal(
        self, column: Int[np.ndarray, " n"] | None = None, row: Int[np.ndarray, " n"] | None = None
    ) -> Float[np.ndarray, "n 3"]:
        if column is None or row is None:
            row, column = self.rows_and_columns()
        places = np.zeros((len(row), 3))
        if self.kind == "aprilgrid":
            tag_mm = self.marker_mm or 0.0
            for axis, n in enumerate((column, row)):
                places[:, axis] = (n // 2) * self.pitch_mm + (n % 2) * tag_mm
            return places
        x = 2 * column + row % 2 if self.kind == "asymmetric_circles" else column
        places[:, 0], places[:, 1] = x * self.pitch_mm, row * self.pitch_mm
        return places


def missing_points_warning(count: int, size: int, reason: str) -> Advisory:
    """Return the warning that `count` of a target's `size` grid points were not measured, for `reason`."""
    return Advisory(
        code="points_missing",
        detail=f"{count} of {size} {reason}",
        advice="Look at the overlay: reflections, dirt or something in front of the grid are the usual causes.",
    )


@dataclass(frozen=True, slots=True)
class GridPoints:
    """Grid points found in one image: which ones, where, and how sure each is.

    `points_px` (n, 2) u right, v down, (0, 0) at the centre of the top-left pixel; `standard_uncertainty_px`
    (n,) is the detector's own estimate, the same for u and v. The fit re-scales it by the residuals where they
    say more.
    """

    target: TargetSpec
    image_width_px: int
    image_height_px: int
    column: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]
    points_px: Float[np.ndarray, "n 2"]
    standard_uncertainty_px: Float[np.ndarray, " n"]
    warnings: tuple[Advisory, ...] = ()
    measured_points_target: Float[np.ndarray, "n 3"] | None = None
    """Where the points of this very board were measured to be (mm), in place of the ideal grid's."""
    markers_px: Mapping[int, Float[np.ndarray, "4 2"]] | None = None
    """Corners of the markers seen on the way, by id, in the order of `CharucoLayout.marker_corners`; no fit takes them.
    None for targets without markers."""
    labelling: Labelling = "absolute"
    capture_quality: CaptureQuality | None = None

    @classmethod
    def whole(
        cls,
        target: TargetSpec,
        size_px: tuple[int, int],
        points_px: Float[np.ndarray, "n 2"],
        sigma_px: float,
    ) -> GridPoints:
        """Return all points of a target, row-major, of one standard uncertainty."""
        row, column = target.rows_and_columns()
        return cls(target, *size_px, column, row, points_px, np.full(target.size, sigma_px))

    @property
    def points_target(self) -> Float[np.ndarray, "n 3"]:
        """The same points in the target frame, mm."""
        if self.measured_points_target is not None:
            return self.measured_points_target
        return self.target.points_target(self.column, self.row)

    def take(self, points: slice | Int[np.ndarray, " k"] | Bool[np.ndarray, " n"]) -> GridPoints:
        """Return some of the points, in the order given."""
        measured = self.measured_points_target
        return replace(
            self,
            column=self.column[points],
            row=self.row[points],
            points_px=self.points_px[points],
            standard_uncertainty_px=self.standard_uncertainty_px[points],
            measured_points_target=None if measured is None else measured[points],
        )

    def __len__(self) -> int:
        return len(self.column)

    def __eq__(self, other: Any) -> bool:
        return (
            isinstance(other, GridPoints)
            and self.target == other.target
            and np.array_equal(self.column, other.column)
            and np.array_equal(self.row, other.row)
            and np.array_equal(self.points_px, other.points_px)
        )

    __hash__ = None  # type: ignore[assignment]
