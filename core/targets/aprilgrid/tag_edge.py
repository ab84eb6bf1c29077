"""The ratio of an AprilGrid's tags to its gaps, from the image, against the one that was stated.

Columns and rows of corners alternate between the two sides of tags. If tags are wider than stated by δ, every second
one lies farther by δ, which no projection of a plane and no lens does: those are smooth. With places x of the corners
as stated, o = (column mod 2, row mod 2), the image m(x) of the places and its derivative J, the corners lie at

    p = m(x) + P(m) + J o δ,

P a polynomial (`core.targets.subpixel.smooth_map`). δ is estimated together with it, by least squares that are
re-weighted, since some corners may have gone astray. Spread ink and blur move no corner where four squares meet, so
that δ is the layout's, and not the print's quality.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.errors import TargetMismatch
from core.targets.aprilgrid.layout import AprilGridLayout
from core.targets.subpixel import GridBasis, grid_basis

_COVERAGE = 3.0  # standard uncertainties
_MAX_DEPARTURE = 0.01  # of the pitch: what less makes is seen in the residuals, and may be the print's
_ROUNDS = 5
_SETTLED, _NEGLIGIBLE = 0.3, 0.1 * _MAX_DEPARTURE  # of the standard uncertainty, of the pitch
_TUKEY = 4.685
"""Of a normal deviate's standard deviation: beyond it a corner does not count (Beaton and Tukey 1974)."""
_RAYLEIGH_MEDIAN = 1.1774  # of distances in the plane, in standard deviations of either coordinate
_MIN_PX = 0.02  # of what is left over: drawings without noise
_MIN_DEGREE = 2
"""Of the polynomial, which contains what another perspective would make; of three tags and more."""
_MIN_SQUARE = 1e-6
_MIN_POINTS = 12


@dataclass(frozen=True, slots=True)
class TagEdge:
    """By how much (mm) tags are wider than stated, at the stated pitch."""

    excess_mm: float
    standard_uncertainty_mm: float


def check_tag_edge(
    layout: AprilGridLayout,
    column: Int[np.ndarray, " n"],
    row: Int[np.ndarray, " n"],
    points_px: Float[np.ndarray, "n 2"],
) -> None:
    """Raise TargetMismatch where the corners' ratio of tag to gap is another than the one stated.

    The limit is a hundredth of the pitch, or the ratio's expanded uncertainty where that is more.
    """
    edge = estimate_tag_edge(layout, column, row, points_px)
    limit = max(_COVERAGE * edge.standard_uncertainty_mm, _MAX_DEPARTURE * layout.target.pitch_mm)
    if not abs(edge.excess_mm) > limit:
        return
    pitch, tag = layout.target.pitch_mm, layout.tag_mm + edge.excess_mm
    raise TargetMismatch(
        f"The AprilGrid's tags are in view, but a tag's edge is {tag / pitch:.3g} of the distance from tag to tag, "
        f"not {layout.tag_mm / pitch:.3g} as stated (marker_mm {layout.tag_mm:g}, pitch_mm {pitch:g}).",
        f"With pitch_mm {pitch:g}, marker_mm is probably {tag:.3g}. Measure both on the print: a tag from black edge "
        "to black edge, and from there to the same edge of the next tag.",
    )


def estimate_tag_edge(
    layout: AprilGridLayout,
    column: Int[np.ndarray, " n"],
    row: Int[np.ndarray, " n"],
    points_px: Float[np.ndarray, "n 2"],
) -> TagEdge:
    """Estimate by how much tags are wider than stated, from corners known to some tenths of a px.

    The uncertainty is infinite where the corners do not determine it.
    """
    if len(column) < _MIN_POINTS:
        return TagEdge(0.0, math.inf)
    places = layout.target.points_target(column, row)[:, :2]
    odd = np.stack([column % 2, row % 2], axis=1).astype(np.float64)
    weights, excess, sigma = np.ones(len(places)), 0.0, math.inf
    for _ in range(_ROUNDS):
        basis = grid_basis(places + excess * odd, points_px, weights)
        if basis.degree < _MIN_DEGREE:
            return TagEdge(0.0, math.inf)
        along_x, along_y = basis.projected[1:3] * (basis.size_px / basis.index_size)
        wider = along_x * odd[:, :1] + along_y * odd[:, 1:]
        off = points_px - basis.projected[0] * basis.size_px - basis.middle_px
        wider, off = np.hsplit(_without_polynomials(basis, np.concatenate([wider, off], axis=1), weights), 2)
        free = 2 * (int(np.count_nonzero(weights)) - basis.polynomials.shape[2]) - 1
        square = float(np.sum(weights[:, None] * wider**2))
        if free < 1 or square < _MIN_SQUARE:
            return TagEdge(0.0, math.inf)
        change = float(np.sum(weights[:, None] * wider * off)) / square
        rest = np.hypot(*(off - change * wider).T)
        sigma = math.sqrt(float(np.sum(weights * rest**2)) / free / square)
        excess += change
        if abs(change) < max(_SETTLED * sigma, _NEGLIGIBLE * layout.target.pitch_mm):
            break
        scale = max(float(np.median(rest[weights > 0.0])) / _RAYLEIGH_MEDIAN, _MIN_PX)
        weights = np.maximum(1.0 - (rest / (_TUKEY * scale)) ** 2, 0.0) ** 2
    return TagEdge(excess, sigma)


def _without_polynomials(
    basis: GridBasis, values: Float[np.ndarray, "n k"], weights: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n k"]:
    """Return what the map's polynomials leave of values, by least squares."""
    if np.all(weights == 1.0):
        Q, _ = basis.factors
        return values - Q @ (Q.T @ values)
    root, polynomials = np.sqrt(weights)[:, None], basis.polynomials[0]
    fitted, *_ = np.linalg.lstsq(root * polynomials, root * values, rcond=None)
    return np.asarray(values - polynomials @ fitted)
