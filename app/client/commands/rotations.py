"""Vectors, rotations and rigid transforms in plain Python: matrices as lists of rows, rad, quaternions x y z w."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

Vector = list[float]
Matrix = list[list[float]]

_AXES = {"x": 0, "y": 1, "z": 2}
_SMALL = 1e-8
_PARTS = 6


def plus(u: Sequence[float], v: Sequence[float], scale: float = 1.0) -> Vector:
    """Return u + scale v."""
    return [a + scale * b for a, b in zip(u, v, strict=True)]


def cross(u: Sequence[float], v: Sequence[float]) -> Vector:
    """Return the vector product."""
    return [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]


def identity() -> Matrix:
    """Return the rotation by nothing."""
    return [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


def product(a: Sequence[Sequence[float]], b: Sequence[Sequence[float]]) -> Matrix:
    """Return the matrix product a b."""
    columns = list(zip(*b, strict=True))
    return [[math.fsum(x * y for x, y in zip(row, c, strict=True)) for c in columns] for row in a]


def transposed(a: Sequence[Sequence[float]]) -> Matrix:
    """Return the transposed matrix."""
    return [list(row) for row in zip(*a, strict=True)]


def applied(a: Sequence[Sequence[float]], v: Sequence[float]) -> Vector:
    """Return the product of a matrix and a vector."""
    return [math.fsum(x * y for x, y in zip(row, v, strict=True)) for row in a]


@dataclass(frozen=True, slots=True)
class Frame:
    """T_a_b: the rotation and the position (mm) of frame b in frame a."""

    rotation: Matrix = field(default_factory=identity)
    position_mm: Vector = field(default_factory=lambda: [0.0, 0.0, 0.0])

    def __matmul__(self, other: Frame) -> Frame:
        """Return T_a_c of T_a_b and T_b_c."""
        position = plus(self.position_mm, applied(self.rotation, other.position_mm))
        return Frame(product(self.rotation, other.rotation), position)

    def inverse(self) -> Frame:
        """Return T_b_a."""
        back = transposed(self.rotation)
        return Frame(back, [-value for value in applied(back, self.position_mm)])

    def column(self, axis: int) -> Vector:
        """Return the direction of an axis of b in a."""
        return [row[axis] for row in self.rotation]


def from_vector(w: Sequence[float]) -> Matrix:
    """Return the rotation about w by its length (Rodrigues' formula)."""
    x, y, z = w
    angle = math.sqrt(x * x + y * y + z * z)
    if angle < _SMALL:
        a, b = 1.0, 0.5
    else:
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle**2
    K = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    KK = product(K, K)
    unit = identity()
    return [[unit[i][j] + a * K[i][j] + b * KK[i][j] for j in range(3)] for i in range(3)]


def about(axis: str, angle: float) -> Matrix:
    """Return the rotation about the axis `x`, `y` or `z`."""
    return from_vector([angle if place == _AXES[axis] else 0.0 for place in range(3)])


def from_quaternion(x: float, y: float, z: float, w: float) -> Matrix:
    """Return the rotation of a quaternion, which need not have the norm 1."""
    n = math.sqrt(x * x + y * y + z * z + w * w)
    x, y, z, w = x / n, y / n, z / n, w / n
    return [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ]


def to_quaternion(r: Sequence[Sequence[float]]) -> tuple[float, float, float, float]:
    """Return the quaternion x, y, z, w of a rotation, w not negative (Shepperd 1978: by the largest component)."""
    trace = r[0][0] + r[1][1] + r[2][2]
    squares = [
        1.0 + 2.0 * r[0][0] - trace,
        1.0 + 2.0 * r[1][1] - trace,
        1.0 + 2.0 * r[2][2] - trace,
        1.0 + trace,
    ]
    largest = max(range(4), key=squares.__getitem__)
    s = 2.0 * math.sqrt(squares[largest])
    if largest == 3:
        q = [(r[2][1] - r[1][2]) / s, (r[0][2] - r[2][0]) / s, (r[1][0] - r[0][1]) / s, s / 4.0]
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        q = [0.0, 0.0, 0.0, (r[k][j] - r[j][k]) / s]
        q[i], q[j], q[k] = s / 4.0, (r[j][i] + r[i][j]) / s, (r[k][i] + r[i][k]) / s
    x, y, z, w = q if q[3] >= 0.0 else [-v for v in q]
    return x, y, z, w


def to_vector(r: Sequence[Sequence[float]]) -> Vector:
    """Return the rotation vector of a rotation, its length in [0, π]."""
    x, y, z, w = to_quaternion(r)
    half = math.hypot(x, y, z)
    scale = 2.0 if half < _SMALL else 2.0 * math.atan2(half, w) / half
    return [scale * x, scale * y, scale * z]


def to_roll_pitch_yaw(r: Sequence[Sequence[float]]) -> tuple[float, float, float]:
    """Return roll, pitch, yaw with R = Rz(yaw) Ry(pitch) Rx(roll); at a pitch of 90° the roll is 0."""
    across = math.hypot(r[0][0], r[1][0])
    pitch = math.atan2(-r[2][0], across)
    if across < _SMALL:
        return 0.0, pitch, math.atan2(-r[0][1], r[1][1])
    return math.atan2(r[2][1], r[2][2]), pitch, math.atan2(r[1][0], r[0][0])


def from_roll_pitch_yaw(roll: float, pitch: float, yaw: float) -> Matrix:
    """Return R = Rz(yaw) Ry(pitch) Rx(roll)."""
    return product(product(about("z", yaw), about("y", pitch)), about("x", roll))


def parse_frame(text: str) -> Frame:
    """Return the frame of `x,y,z,roll,pitch,yaw` in mm and degrees. Raises ValueError."""
    numbers = [float(part) for part in text.split(",")]
    if len(numbers) != _PARTS or not all(map(math.isfinite, numbers)):
        raise ValueError("a frame has six numbers")
    return Frame(from_roll_pitch_yaw(*map(math.radians, numbers[3:])), numbers[:3])


def frame_words(frame: Frame) -> str | None:
    """Return a frame as `parse_frame` takes it, to .1 µm and .00001°; None where that is no motion at all."""
    angles = map(math.degrees, to_roll_pitch_yaw(frame.rotation))
    numbers = [*(round(v, 4) for v in frame.position_mm), *(round(v, 5) for v in angles)]
    return ",".join(f"{v + 0.0:.9g}" for v in numbers) if any(numbers) else None
