"""Poses from several reflectors on the flange: the rigid motion that takes their known places to the measured ones.

Minimised is sum |p_i - t - R q_i|² / u_i², with q_i in the flange's frame and p_i in the instrument's, mm. From the
frames of three reflectors, Gauss-Newton steps with δp = δt + w x R q reach the minimum; their normal matrix is the
inverse of the covariance of (t, w), w in the instrument's frame, rad.

Reference: K. S. Arun, T. S. Huang, S. D. Blostein, IEEE TPAMI 9 (1987) 698-700, 10.1109/TPAMI.1987.4767965.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ... import Json
from ...pose_rows import number_of
from ..record_files import FileRefused, read_records, refuse_mixed_signs
from ..rotations import Matrix, Vector, applied, cross, from_vector, identity, plus, product, transposed
from .parser import RowError

_PLACE = ("x_mm", "y_mm", "z_mm")
_MIN_REFLECTORS = 3
_MIN_SINE = 0.02
"""Sine of the angle between two edges of a triangle of reflectors, below which they are one line."""
_MAX_RESIDUAL_U = 5.0
_MAX_RESIDUAL_SHARE = 0.01
"""Of the distance of reflectors, without uncertainties: beyond it their names are mixed up."""
_STEPS = 20
_SMALL = 1e-12


@dataclass(frozen=True, slots=True)
class Reading:
    """One reflector measured once: its place in the file, its name, the pose as parsed."""

    place: str
    reflector: str
    pose: Json


@dataclass(frozen=True, slots=True)
class Fit:
    """T_instrument_flange, its covariance in the unit of the weights, and the residual of each point, mm."""

    position: Vector
    rotation: Matrix
    covariance: Matrix
    residuals: list[float]


def read_reflectors(path: Path) -> dict[str, Vector]:
    """Return the reflectors of a table with name, x_mm, y_mm, z_mm, in the flange's frame. Raises FileRefused."""
    found: dict[str, Vector] = {}
    records = read_records(path, None, None)
    refuse_mixed_signs(records, _PLACE)
    for record in records.entries:
        name = str(record.fields.get("name", record.name or "")).strip()
        place = [number_of(str(record.fields.get(axis)), comma=records.delimiter != ",") for axis in _PLACE]
        if not name or name in found or not all(map(math.isfinite, place)):
            raise FileRefused(
                f"In {record.place} of {path.name} there is no new reflector with its coordinates.",
                "Write name, x_mm, y_mm, z_mm of each, in the flange's frame.",
            )
        found[name] = place
    if _three_of(list(found.values())) is None:
        raise FileRefused(
            f"{path.name} has {len(found)} reflectors; a pose needs three that are not on one line.",
            "Measure their places on the flange once, e.g. while it stands still in two orientations.",
        )
    return found


def poses_of_reflectors(
    readings: Sequence[Reading], reflectors: Mapping[str, Vector]
) -> tuple[list[tuple[str, Json]], list[RowError], tuple[float, str]]:
    """Return (place, measured pose) of every pose and cycle, errors, and the largest residual (mm) with its place.

    Readings of one pose and cycle belong together; hidden reflectors may be absent while three remain. Where each has a
    covariance, the pose has one, too.
    """
    together: dict[tuple[str, int | None], list[Reading]] = {}
    for reading in readings:
        together.setdefault((reading.pose["pose_id"], reading.pose["cycle"]), []).append(reading)
    poses, errors, largest = [], list[RowError](), (0.0, "")
    for members in together.values():
        place = members[0].place
        names = [member.reflector for member in members]
        unknown = sorted(set(names) - set(reflectors))
        if unknown or len(set(names)) < len(names):
            what = f"names {', '.join(unknown)}, not of --reflectors" if unknown else "has a reflector twice"
            errors.append(RowError(place, what))
            continue
        q = [reflectors[name] for name in names]
        if _three_of(q) is None:
            errors.append(RowError(place, f"has {len(q)} reflectors; three not on one line are needed"))
            continue
        known = all(member.pose["covariance"] is not None for member in members)
        u = [_uncertainty(member.pose["covariance"]) if known else 1.0 for member in members]
        found = fit([member.pose["position_mm"] for member in members], q, u)
        worst = max(range(len(q)), key=lambda i: found.residuals[i] / u[i])
        largest = max(largest, (found.residuals[worst], members[worst].place))
        limit_mm = (
            _MAX_RESIDUAL_U * u[worst]
            if known
            else _MAX_RESIDUAL_SHARE * max(itertools.starmap(math.dist, itertools.combinations(q, 2)))
        )
        if found.residuals[worst] > limit_mm:
            message = (
                f"reflector {names[worst]} is {found.residuals[worst]:.3f} mm from where the others have it"
            )
            errors.append(RowError(members[worst].place, message))
            continue
        pose = {
            **members[0].pose,
            "position_mm": found.position,
            "rotation": found.rotation,
            "covariance": found.covariance if known else None,
        }
        poses.append((place, pose))
    return poses, errors, largest


def fit(p: Sequence[Vector], q: Sequence[Vector], u: Sequence[float]) -> Fit:
    """Return the rigid motion from q to p, three or more points not on one line, with standard uncertainties u."""
    a, b, c = _three_of(q) or (0, 1, 2)
    R = product(_frame(p[a], p[b], p[c]), transposed(_frame(q[a], q[b], q[c])))
    t = plus(p[a], applied(R, q[a]), -1.0)
    inverse: Matrix = []
    for _ in range(_STEPS):
        normal, right = [[0.0] * 6 for _ in range(6)], [0.0] * 6
        for point, place, sigma in zip(p, q, u, strict=True):
            arm = applied(R, place)
            x, y, z = arm
            J = [[1.0, 0.0, 0.0, 0.0, z, -y], [0.0, 1.0, 0.0, -z, 0.0, x], [0.0, 0.0, 1.0, y, -x, 0.0]]
            r = plus(plus(point, t, -1.0), arm, -1.0)
            for row, residual in zip(J, r, strict=True):
                for i in range(6):
                    right[i] += row[i] * residual / sigma**2
                    for j in range(6):
                        normal[i][j] += row[i] * row[j] / sigma**2
        inverse = _inverted(normal)
        step = applied(inverse, right)
        t = plus(t, step[:3])
        R = product(from_vector(step[3:]), R)
        if max(map(abs, step)) < _SMALL:
            break
    residuals = [math.dist(point, plus(t, applied(R, place))) for point, place in zip(p, q, strict=True)]
    covariance = [[(inverse[i][j] + inverse[j][i]) / 2.0 for j in range(6)] for i in range(6)]
    return Fit(t, R, covariance, residuals)


def _uncertainty(covariance: Matrix) -> float:
    """Return the root mean square of the standard uncertainties of a point's coordinates, mm."""
    return math.sqrt(math.fsum(covariance[i][i] for i in range(3)) / 3.0) or _SMALL


def _three_of(points: Sequence[Vector]) -> tuple[int, int, int] | None:
    """Return the three points of the largest triangle; None where all are on one line."""
    best: tuple[float, tuple[int, int, int]] = (0.0, (0, 0, 0))
    for a, b, c in itertools.combinations(range(len(points)), _MIN_REFLECTORS):
        one, two = plus(points[b], points[a], -1.0), plus(points[c], points[a], -1.0)
        area = math.hypot(*cross(one, two))
        if area > _MIN_SINE * math.hypot(*one) * math.hypot(*two):
            best = max(best, (area, (a, b, c)))
    return best[1] if best[0] > 0.0 else None


def _frame(a: Vector, b: Vector, c: Vector) -> Matrix:
    """Return the rotation whose x is along ab and whose z is across the triangle; the unit one for one line."""
    x, across = plus(b, a, -1.0), cross(plus(b, a, -1.0), plus(c, a, -1.0))
    if not math.hypot(*x) or not math.hypot(*across):
        return identity()
    x, z = _unit(x), _unit(across)
    return transposed([x, cross(z, x), z])


def _inverted(a: Matrix) -> Matrix:
    """Return the inverse of a positive definite matrix by Gauss-Jordan elimination with scaled rows."""
    n = len(a)
    scale = [1.0 / math.sqrt(a[i][i]) for i in range(n)]
    rows = [
        [a[i][j] * scale[i] * scale[j] for j in range(n)] + [float(i == j) for j in range(n)]
        for i in range(n)
    ]
    for i in range(n):
        pivot = max(range(i, n), key=lambda k: abs(rows[k][i]))
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [value / rows[i][i] for value in rows[i]]
        for k in range(n):
            if k != i:
                rows[k] = [value - rows[k][i] * own for value, own in zip(rows[k], rows[i], strict=True)]
    return [[rows[i][n + j] * scale[i] * scale[j] for j in range(n)] for i in range(n)]


def _unit(a: Sequence[float]) -> Vector:
    length = math.hypot(*a)
    return [x / length for x in a]
