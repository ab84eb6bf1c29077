"""Classic Denavit-Hartenberg parameters from joint axes, by the common normals of neighbours.

The axes are lines in the base's frame at joint angles of zero, in mm. Frame i has its z along axis i + 1, and x_i along
the common normal of axes i and i + 1, so that T_{i-1,i} = Rz(θ_i + offset_i) Tz(d_i) Tx(a_i) Rx(α_i). Where axes are
parallel, the normal through origin i - 1 is taken: d_i = 0, as makers have it. Of x_i and -x_i, the one is taken that
makes the offset small, then a_i positive.

Axes of an identified arm are nearly parallel, and their common normal may be hundreds of metres away. They have
Hayati's form: origin i lies where axis i + 1 pierces the plane across axis i through origin i - 1, x' points there from
origin i - 1, and Ry(β_i) follows Rx(α_i) about x'. This form is exact, too.

References: J. Denavit, R. S. Hartenberg, J. Appl. Mech. 22 (1955) 215-221; S. A. Hayati, "Robot arm geometric link
parameter estimation", CDC 1983.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ..rotations import Frame, Vector, about, applied, cross, plus, product

_PARALLEL = 1e-6
"""Sine of the angle below which axes are parallel: over metres that is micrometres."""
_NEARLY_PARALLEL = 0.05
"""Sine of the angle below which axes are meant to be parallel: none is designed at 3°, or built as badly."""
_ACROSS = 1e-3
"""Cosine of the angle below which a direction is taken to be across an axis."""
_ON_AXIS_MM = 1e-6
_DECIMALS = 9


@dataclass(frozen=True, slots=True)
class Axis:
    """A joint's axis: a point in mm, and the direction about which it turns by a positive angle."""

    point: Vector
    direction: Vector


@dataclass(frozen=True, slots=True)
class DhRow:
    """One joint: mm and rad; β of axes that are nearly parallel."""

    a: float
    alpha: float
    d: float
    offset: float
    beta: float = 0.0

    def frame(self, angle: float) -> Frame:
        """Return T_{i-1,i} for the joint's angle, rad."""
        turned = about("z", angle + self.offset)
        link = product(about("x", self.alpha), about("y", self.beta))
        return Frame(product(turned, link), [self.a * turned[0][0], self.a * turned[1][0], self.d])


def dot(u: Sequence[float], v: Sequence[float]) -> float:
    """Return the scalar product."""
    return math.fsum(a * b for a, b in zip(u, v, strict=True))


def unit(v: Sequence[float]) -> Vector:
    """Return the vector with the length 1."""
    length = math.sqrt(dot(v, v))
    return [a / length for a in v]


def dh_of_axes(axes: Sequence[Axis], flange: Frame) -> tuple[list[DhRow], Frame]:
    """Return the parameters of each joint, and frame 0 in the base's frame.

    Frame 0 lies on the first axis where the base's origin is nearest, with x along the base's x as far as it can. The
    last frame is the flange where four parameters suffice for it; else it has the flange's height along the last axis.
    """
    z = unit(axes[0].direction)
    x = _across([1.0, 0.0, 0.0], z) or _across([0.0, 1.0, 0.0], z)
    assert x is not None
    origin = plus(axes[0].point, z, -dot(axes[0].point, z))
    base = _framed(origin, x, z)
    rows: list[DhRow] = []
    for axis in axes[1:]:
        row, origin, x, z = _next(origin, x, z, axis)
        rows.append(row)
    rows.append(_last(origin, x, z, flange))
    return [_rounded(row) for row in rows], base


def _next(origin: Vector, x: Vector, z: Vector, axis: Axis) -> tuple[DhRow, Vector, Vector, Vector]:
    """Return the row between two axes, and the next frame's origin, x and z."""
    m = unit(axis.direction)
    normal = cross(z, m)
    sine = math.sqrt(dot(normal, normal))
    between = plus(axis.point, origin, -1.0)
    if sine < _NEARLY_PARALLEL:
        foot = origin
        following = plus(axis.point, m, -dot(between, z) / dot(m, z))
        out = plus(following, foot, -1.0)
        out = plus(out, z, -dot(out, z))
        along = unit(out) if dot(out, out) > _ON_AXIS_MM**2 else x
    else:
        foot = plus(origin, z, dot(cross(between, m), normal) / sine**2)
        following = plus(axis.point, m, dot(cross(between, z), normal) / sine**2)
        along = unit(normal)
    rows = []
    for candidate in (along, [-v for v in along]):
        step = plus(following, foot, -1.0)
        alpha, beta = _turns(candidate, z, m, sine)
        row = DhRow(
            dot(step, candidate),
            alpha,
            dot(plus(foot, origin, -1.0), z),
            math.atan2(dot(cross(x, candidate), z), dot(x, candidate)),
            beta,
        )
        # An arm as built has a quarter turn but for some hundredths of a degree: neither sign of it is the smaller.
        cost = (round(abs(row.offset), 1), -round(row.a, 6), -round(math.sin(row.alpha), 6))
        rows.append((cost, row, candidate))
    _, row, chosen = min(rows, key=lambda found: found[0])
    link = product(about("x", row.alpha), about("y", row.beta))
    return row, following, applied(_framed(origin, chosen, z).rotation, [one[0] for one in link]), m


def _turns(x: Vector, z: Vector, m: Vector, sine: float) -> tuple[float, float]:
    """Return α and β from z to m, in the frame of z with this x.

    Rx(α) Ry(β) z = (sin β, -sin α cos β, cos α cos β).
    """
    if sine < _PARALLEL:
        return math.acos(_sign(dot(z, m))), 0.0
    alpha = math.atan2(dot(cross(z, m), x), dot(z, m))
    return alpha, math.asin(dot(m, x)) if sine < _NEARLY_PARALLEL else 0.0


def _last(origin: Vector, x: Vector, z: Vector, flange: Frame) -> DhRow:
    """Return the last joint's row: x of the flange where it is across the axis and meets it."""
    step = plus(flange.position_mm, origin, -1.0)
    d = dot(step, z)
    across = plus(step, z, -d)
    x_flange, z_flange = flange.column(0), flange.column(2)
    a = dot(across, x_flange)
    off_axis = plus(across, x_flange, -a)
    if abs(dot(x_flange, z)) > _ACROSS or math.sqrt(dot(off_axis, off_axis)) > _ON_AXIS_MM:
        return DhRow(0.0, math.acos(_sign(dot(z, z_flange))), d, 0.0)
    alpha = math.atan2(dot(cross(z, z_flange), x_flange), dot(z, z_flange))
    offset = math.atan2(dot(cross(x, x_flange), z), dot(x, x_flange))
    return DhRow(a, alpha, d, offset)


def _framed(origin: Vector, x: Vector, z: Vector) -> Frame:
    y = cross(z, x)
    return Frame([[x[i], y[i], z[i]] for i in range(3)], origin)


def _across(v: Vector, z: Vector) -> Vector | None:
    """Return the direction of v across z; None where v is along z."""
    w = plus(v, z, -dot(v, z))
    return unit(w) if dot(w, w) > _ACROSS else None


def _sign(value: float) -> float:
    return 1.0 if value >= 0.0 else -1.0


def _rounded(row: DhRow) -> DhRow:
    """Return the row without the noise of double precision, and -π as π."""
    a, alpha, d, offset, beta = (
        round(v, _DECIMALS) + 0.0 for v in (row.a, row.alpha, row.d, row.offset, row.beta)
    )
    least = -math.pi + 10.0**-_DECIMALS
    return DhRow(a, math.pi if alpha < least else alpha, d, math.pi if offset < least else offset, beta)
