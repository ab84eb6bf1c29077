"""Classic Denavit-Hartenberg parameters from joint axes, by the common normals of neighbours.

The axes are lines in the base's frame at joint angles of zero, in mm. Frame i has its z along axis i + 1, and x_i along
the common normal of axes i and i + 1, so that T_{i-1,i} = Rz(θ_i + offset_i) Tz(d_i) Tx(a_i) Rx(α_i). Where axes are
parallel, the normal through origin i - 1 is taken: d_i = 0, as makers have it. Of x_i and -x_i, the one is taken that
makes the offset small, then a_i positive.

Reference: J. Denavit, R. S. Hartenberg, J. Appl. Mech. 22 (1955) 215-221.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ..rotations import Matrix, Vector, about, applied, cross, plus, product

_PARALLEL = 1e-3
"""Sine of the angle below which axes are described as parallel: beyond it no maker designs them so."""
_ON_AXIS_MM = 1e-6
_DECIMALS = 9


@dataclass(frozen=True, slots=True)
class Frame:
    """A pose: origin in mm, axes as the columns of a rotation."""

    origin: Vector
    rotation: Matrix

    def column(self, axis: int) -> Vector:
        return [row[axis] for row in self.rotation]

    def then(self, other: Frame) -> Frame:
        """Return the pose of `other`, which is given in this frame, in this frame's own base."""
        return Frame(
            plus(self.origin, applied(self.rotation, other.origin)), product(self.rotation, other.rotation)
        )


@dataclass(frozen=True, slots=True)
class Axis:
    """A joint's axis: a point in mm, and the direction about which it turns by a positive angle."""

    point: Vector
    direction: Vector


@dataclass(frozen=True, slots=True)
class DhRow:
    """One joint: mm and rad."""

    a: float
    alpha: float
    d: float
    offset: float

    def frame(self, angle: float) -> Frame:
        """Return T_{i-1,i} for the joint's angle, rad."""
        turned = about("z", angle + self.offset)
        return Frame(
            [self.a * turned[0][0], self.a * turned[1][0], self.d], product(turned, about("x", self.alpha))
        )


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
    if sine < _PARALLEL:
        foot = origin
        following = plus(axis.point, m, -dot(between, m))
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
        row = DhRow(
            dot(step, candidate),
            math.atan2(dot(cross(z, m), candidate), dot(z, m))
            if sine >= _PARALLEL
            else math.acos(_sign(dot(z, m))),
            dot(plus(foot, origin, -1.0), z),
            math.atan2(dot(cross(x, candidate), z), dot(x, candidate)),
        )
        cost = (round(abs(row.offset), 6), -round(row.a, 6), -round(math.sin(row.alpha), 6))
        rows.append((cost, row, candidate))
    _, row, chosen = min(rows, key=lambda found: found[0])
    return row, following, chosen, m


def _last(origin: Vector, x: Vector, z: Vector, flange: Frame) -> DhRow:
    """Return the last joint's row: x of the flange where it is across the axis and meets it."""
    step = plus(flange.origin, origin, -1.0)
    d = dot(step, z)
    across = plus(step, z, -d)
    x_flange, z_flange = flange.column(0), flange.column(2)
    a = dot(across, x_flange)
    off_axis = plus(across, x_flange, -a)
    if abs(dot(x_flange, z)) > _PARALLEL or math.sqrt(dot(off_axis, off_axis)) > _ON_AXIS_MM:
        return DhRow(0.0, math.acos(_sign(dot(z, z_flange))), d, 0.0)
    alpha = math.atan2(dot(cross(z, z_flange), x_flange), dot(z, z_flange))
    offset = math.atan2(dot(cross(x, x_flange), z), dot(x, x_flange))
    return DhRow(a, alpha, d, offset)


def _framed(origin: Vector, x: Vector, z: Vector) -> Frame:
    y = cross(z, x)
    return Frame(origin, [[x[i], y[i], z[i]] for i in range(3)])


def _across(v: Vector, z: Vector) -> Vector | None:
    """Return the direction of v across z; None where v is along z."""
    w = plus(v, z, -dot(v, z))
    return unit(w) if dot(w, w) > _PARALLEL else None


def _sign(value: float) -> float:
    return 1.0 if value >= 0.0 else -1.0


def _rounded(row: DhRow) -> DhRow:
    """Return the row without the noise of double precision, and -π as π."""
    a, alpha, d, offset = (round(v, _DECIMALS) + 0.0 for v in (row.a, row.alpha, row.d, row.offset))
    least = -math.pi + 10.0**-_DECIMALS
    return DhRow(a, math.pi if alpha < least else alpha, d, math.pi if offset < least else offset)
