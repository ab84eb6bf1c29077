"""Inspection of a printed target: its deviations from nominal, a verdict on each, and what to do about it.

From a target's estimated shape (`target_shape`) follow measures, each as a share of the same limit: of lengths a share
of the grid's longer side, of angles and ratios the share itself. With U = 2 u a measure v is

    fine        |v| + U ≤ limit,
    off         |v| - U > limit,
    undecided   else.

Of the largest of n deviations, noise alone makes more than of one: there U holds with 95 % for all n together.

Photographs determine no length. Where a rule along the print read r for a length s, the pitch along x and y follows
from ln(r / s) along either and from ln(x / y), the ratio of both, by least squares.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from scipy.special import chdtri

from core.calibration.target_shape.deformation import Measure, TargetShape, without_low_order
from core.calibration.target_shape.rule_readings import RuleReading, check_asked, pitches_of
from core.targets import TargetSpec

LIMIT = 1e-3
MIN_CHECK_DIRECTIONS = 6
"""Fewer than a refined target takes for analyses: a check with too few ends undecided, not wrong."""
_COVERAGE = 2.0
_LOW_ORDER = ("bow_x_mm", "bow_y_mm", "twist_mm", "aspect", "shear_rad")
Verdict = Literal["fine", "off", "undecided"]

_PRINT_AGAIN = (
    "Print again at 100 % with every fitting, scaling and margin option off; where it stays, on another printer, since "
    "many feed paper unevenly"
)
_MOUNT = (
    "Mount the print on something stiff and flat (glass, an aluminium sheet), glued on all of its surface."
)
_TILTED_VIEWS = "the target tilted by 20° to 40° to all sides"
_MORE_PHOTOS = f"Add photos with {_TILTED_VIEWS}, and with the camera turned by 90°."
_TOO_NEAR = (
    "It is too near the limit for photographs to decide: take it as off, or allow more (--tolerance-percent)."
)
_NEAR = "It is near the limit: more photographs may decide. Or take it as off, or allow more (--tolerance-percent)."
_MIN_MORE_PHOTOS, _MAX_MORE_PHOTOS = 4, 50


@dataclass(frozen=True, slots=True)
class PrintedShape:
    """A target's shape as estimated, by this process or by a service; arrays and measures as in `TargetShape`."""

    target: TargetSpec
    column: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]
    deviations_mm: Float[np.ndarray, "n 3"]
    standard_uncertainty_mm: Float[np.ndarray, "n 3"]
    bow_x_mm: Measure
    bow_y_mm: Measure
    twist_mm: Measure
    aspect: Measure
    shear: Measure
    photos: int | None = None
    single_direction_uncertainty: Float[np.ndarray, "5"] | None = None
    """As in `TargetShape`; with it, undecided findings say how many photographs would decide."""

    @classmethod
    def of(cls, shape: TargetShape) -> PrintedShape:
        return cls(
            shape.target,
            shape.column,
            shape.row,
            shape.deviations_mm,
            shape.standard_uncertainty_mm,
            shape.bow_x_mm,
            shape.bow_y_mm,
            shape.twist_mm,
            shape.aspect,
            shape.shear,
            len(shape.used_views),
            shape.single_direction_uncertainty,
        )

    def photos_needed(self, code: str, wanted: float, u: float) -> str | None:
        """Return which photographs would reduce a measure's standard uncertainty from u to the wanted one.

        None where the shape does not say what it was estimated from.
        """
        if self.photos is None or self.single_direction_uncertainty is None:
            return None
        # u² falls with the number of photographs, and of those with the camera turned as with as many that are not.
        more_like_these = self.photos * (u / wanted) ** 2 - self.photos if wanted != 0.0 else math.inf
        turned = math.inf
        if code in _LOW_ORDER and wanted != 0.0:
            both = (
                2.0
                * self.photos
                * (float(self.single_direction_uncertainty[_LOW_ORDER.index(code)]) / wanted) ** 2
            )
            turned = max(both - self.photos, 0.5 * min(both, self.photos))
        fewer_turned = turned < 0.7 * more_like_these
        count = max(turned if fewer_turned else more_like_these, _MIN_MORE_PHOTOS)
        if count > _MAX_MORE_PHOTOS:
            return _TOO_NEAR
        how = "with the camera turned by 90° (upright, not level)" if fewer_turned else "like these"
        return f"Add about {math.ceil(count)} photos {how}, {_TILTED_VIEWS}: if the value stays, they decide."


@dataclass(frozen=True, slots=True)
class PrintFinding:
    """One measure against its limit, in `unit` ("" for a ratio); `advice` where it is not fine."""

    code: str
    unit: str
    value: float
    standard_uncertainty: float
    limit: float
    verdict: Verdict
    detail: str
    advice: str | None


@dataclass(frozen=True, slots=True)
class PrintCheck:
    """All measures, the worst first of those that are off; pitches along x and y where a rule was read."""

    findings: tuple[PrintFinding, ...]
    pitch_x_mm: Measure | None
    pitch_y_mm: Measure | None

    @property
    def verdict(self) -> Verdict:
        """`off` if any measure is off, else `undecided` if any is undecided, else `fine`."""
        verdicts = {finding.verdict for finding in self.findings}
        return "off" if "off" in verdicts else "undecided" if "undecided" in verdicts else "fine"


def check_print(
    shape: PrintedShape, readings: Sequence[RuleReading] = (), *, limit: float = LIMIT
) -> PrintCheck:
    """Compare a print with its nominal dimensions.

    `limit` is how far it may be off, as a share of the grid's longer side.

    Raises InvalidArgument for a limit or a reading that cannot be meant.
    """
    check_asked(readings, limit)
    places = shape.target.points_target(shape.column, shape.row)
    extent = float(np.max(np.ptp(places, axis=0)))
    pitches = pitches_of(readings, shape.aspect, shape.target.pitch_mm)
    findings = [
        _ratio(shape, limit),
        _angle(shape, limit),
        _bow(shape, "bow_x_mm", shape.bow_x_mm, limit * extent),
        _bow(shape, "bow_y_mm", shape.bow_y_mm, limit * extent),
        _bow(shape, "twist_mm", shape.twist_mm, limit * extent),
        *_local(shape, places, limit * extent),
        *(
            _scale(axis, pitch, shape.target.pitch_mm, limit)
            for axis, pitch in zip("xy", pitches or (), strict=False)
        ),
    ]
    rank = {"off": 0, "undecided": 1, "fine": 2}
    findings.sort(key=lambda f: (rank[f.verdict], -abs(f.value) / f.limit))
    return PrintCheck(tuple(findings), *(pitches or (None, None)))


def _verdict_of(value: float, half_width: float, limit: float) -> Verdict:
    if abs(value) + half_width <= limit:
        return "fine"
    return "off" if abs(value) - half_width > limit else "undecided"


def _finding(
    shape: PrintedShape,
    code: str,
    unit: str,
    measure: Measure,
    limit: float,
    detail: str,
    cure: str,
    coverage: float = _COVERAGE,
) -> PrintFinding:
    value, u = measure.value, measure.standard_uncertainty
    verdict = _verdict_of(value, coverage * u, limit)
    advice = None if verdict == "fine" else cure
    if verdict == "undecided":
        photos_needed = shape.photos_needed(code, (limit - abs(value)) / coverage, u)
        if photos_needed is not None:
            advice = photos_needed if photos_needed != _TOO_NEAR else f"{_TOO_NEAR} {cure}"
        elif coverage * u > 0.5 * limit:
            advice = _MORE_PHOTOS
        else:
            advice = f"{_NEAR} {cure}"
    return PrintFinding(code, unit, value, u, limit, verdict, detail, advice)


def _ratio(shape: PrintedShape, limit: float) -> PrintFinding:
    aspect = shape.aspect
    longer, shorter = ("x", "y") if aspect.value >= 0.0 else ("y", "x")
    detail = f"It is {_percent(aspect)} longer along {longer} than along {shorter}."
    cure = f"{_PRINT_AGAIN}. One pitch cannot describe it: refine the target in the session's analyses till then."
    return _finding(shape, "aspect", "", aspect, limit, detail, cure)


def _angle(shape: PrintedShape, limit: float) -> PrintFinding:
    shear = shape.shear
    angle, uncertainty = (
        90.0 - math.degrees(shear.value),
        math.degrees(_COVERAGE * shear.standard_uncertainty),
    )
    detail = f"Its axes meet at {_rounded(angle, uncertainty, '°')}."
    return _finding(shape, "shear_rad", "rad", shear, limit, detail, f"{_PRINT_AGAIN}.")


def _bow(shape: PrintedShape, code: str, bow: Measure, limit_mm: float) -> PrintFinding:
    side = "behind" if bow.value >= 0.0 else "in front of"
    statement = {
        "bow_x_mm": "The middle of a row lies {} the line between the row's ends",
        "bow_y_mm": "The middle of a column lies {} the line between the column's ends",
        "twist_mm": "Two opposite corners, the first one's and the last one's, lie {} the plane of the whole",
    }[code].format(f"{_mm(bow.value, bow.standard_uncertainty)} {side}")
    return _finding(shape, code, "mm", bow, limit_mm, f"{statement}.", _MOUNT)


def _local(
    shape: PrintedShape, places: Float[np.ndarray, "n 3"], limit_mm: float
) -> tuple[PrintFinding, PrintFinding]:
    """Return the largest deviations in the plane and out of it, of what stretch, shear and bow leave."""
    rest = without_low_order(places - places.mean(axis=0), shape.deviations_mm.ravel())
    u = shape.standard_uncertainty_mm
    found = []
    for code, axes, cure in (
        ("local_in_plane_mm", [0, 1], "Look there for creases, bubbles and blots, and print again."),
        ("local_out_of_plane_mm", [2], _MOUNT),
    ):
        distance = np.sqrt(np.sum(rest[:, axes] ** 2, axis=1))
        worst = int(np.argmax(distance))
        length = float(distance[worst])
        along = rest[worst, axes] / length if length > 0.0 else np.zeros(len(axes))
        uncertainty = float(np.sqrt(np.sum((along * u[worst, axes]) ** 2)))
        coverage = math.sqrt(float(chdtri(len(axes), 0.05 / len(places))))
        where = "in its plane" if len(axes) == 2 else "out of its plane"
        detail = (
            f"Grid point ({shape.column[worst]}, {shape.row[worst]}) is farthest from where the others put it "
            f"{where}: {_mm(length, uncertainty, coverage)}."
        )
        found.append(
            _finding(shape, code, "mm", Measure(length, uncertainty), limit_mm, detail, cure, coverage)
        )
    return found[0], found[1]


def _scale(axis: str, pitch: Measure, stated_mm: float, limit: float) -> PrintFinding:
    off = Measure(pitch.value / stated_mm - 1.0, pitch.standard_uncertainty / stated_mm)
    detail = (
        f"Its pitch along {axis} is {_rounded(pitch.value, _COVERAGE * pitch.standard_uncertainty, ' mm')}, "
        f"{_percent(off)} {'more' if off.value >= 0.0 else 'less'} than stated."
    )
    half_width = _COVERAGE * off.standard_uncertainty
    cure = f"{_PRINT_AGAIN}; or state the pitch as measured."
    verdict = _verdict_of(off.value, half_width, limit)
    if verdict == "undecided" and half_width > 0.5 * limit:
        cure = "Read the rule over the ruler's whole length, with a magnifier, and both along x and along y."
    advice = None if verdict == "fine" else cure
    return PrintFinding(
        f"scale_{axis}", "", off.value, off.standard_uncertainty, limit, verdict, detail, advice
    )


def _percent(share: Measure) -> str:
    return _rounded(100.0 * abs(share.value), 100.0 * _COVERAGE * share.standard_uncertainty, " %")


def _mm(length: float, standard_uncertainty: float, coverage: float = _COVERAGE) -> str:
    return _rounded(abs(length), coverage * standard_uncertainty, " mm")


def _rounded(value: float, uncertainty: float, unit: str) -> str:
    """Return a value with its expanded uncertainty, which is given two digits."""
    digits = min(max(0, 1 - math.floor(math.log10(uncertainty))), 6) if uncertainty > 0.0 else 6
    return f"{value:.{digits}f}{unit} (± {uncertainty:.{digits}f}{unit})"
