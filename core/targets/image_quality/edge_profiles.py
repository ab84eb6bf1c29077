"""Locate the edges of a target in an image from its grid points, and how far along them nothing else is printed:
middles of squares' sides, and places around dots."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.targets.specification import GridPoints

_PROFILES = 60  # of each direction: the average's noise is a few thousandths of the contrast
_REACH = 0.45  # of the distance to the next edge: nearly to the middle of the square
_MARGIN = 0.8  # of the space between a square's edge and the marker in it


@dataclass(frozen=True, slots=True)
class Edges:
    """Where edges are, which way they are crossed, and which of them belong together."""

    middle: Float[np.ndarray, "n 2"]
    across: Float[np.ndarray, "n 2"]
    half_px: Float[np.ndarray, " n"]
    straight_px: Float[np.ndarray, " n"]  # how wide a blur may be for the edge to be as a straight one
    family: Int[np.ndarray, " n"]
    families: int


def square_corners(points: GridPoints) -> Int[np.ndarray, "n 3"]:
    """Return points with their next ones along x and y: corners of squares; of an AprilGrid of those between tags."""
    table = np.full((int(points.row.max()) + 1, int(points.column.max()) + 1), -1, dtype=np.intp)
    table[points.row, points.column] = np.arange(len(points))
    first, along, down = table[:-1, :-1], table[:-1, 1:], table[1:, :-1]
    whole = (first >= 0) & (along >= 0) & (down >= 0)
    if points.target.kind == "aprilgrid":
        whole[::2] = False
        whole[:, ::2] = False
    return np.stack([first[whole], along[whole], down[whole]], axis=1)


def square_edges(points: GridPoints, cells: Int[np.ndarray, "n 3"]) -> Edges:
    """Return the middles of the squares' sides along x (family 0) and y (family 1)."""
    few = cells[thinned(np.arange(len(cells)))]
    start, along, down = (points.points_px[few[:, k]] for k in range(3))
    a, b = along - start, down - start
    area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    length = np.stack([np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)])
    across = np.concatenate([normals(a), normals(b)])
    # As a tilted square's image leans, a profile nears its other two sides: no further than where they are as near as
    # its own.
    wide = area / length
    leaning = np.abs(np.sum(a * b, axis=1)) / (length[0] * length[1])
    half = np.minimum(free_of_marker(points) * wide, 0.5 * wide[::-1] / (1.0 + leaning)).ravel()
    return Edges(
        middle=np.concatenate([start + 0.5 * a, start + 0.5 * b]),
        across=across,
        half_px=half,
        straight_px=half,
        family=np.repeat(np.arange(2), len(few)),
        families=2,
    )


def dot_edges(points: GridPoints, H: Float[np.ndarray, "3 3"]) -> Edges:
    """Return the edges of dots in four directions of the target, each a family.

    By the plane's local map A a circle's normal q is A⁻ᵀ q in the image. A dot has between a fifth and two thirds of
    the distance to the next one as its diameter.
    """
    target = points.target
    apart_mm = target.pitch_mm * (math.sqrt(2.0) if target.kind == "asymmetric_circles" else 1.0)
    radius_mm = 0.5 * (target.marker_mm or 0.5 * apart_mm)
    few = thinned(np.arange(len(points)))
    A = local_map(H, points.points_target[few])
    angle = np.repeat(np.arange(4) * (0.25 * math.pi), len(few))
    q = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    A = np.tile(A, (4, 1, 1))
    turned = np.einsum("nji,nj->ni", np.linalg.inv(A), q)
    steep = np.linalg.norm(turned, axis=1)  # mm per px
    reach = radius_mm / steep  # from the middle of the dot's image to its tangent
    # No further inward than the ellipse is wide, or the profile would come out at its other side.
    inward = np.minimum(reach, radius_mm * np.linalg.svd(A, compute_uv=False)[:, 1])
    half = np.minimum(inward, (0.5 * apart_mm - radius_mm) / steep)
    curvature_radius = (radius_mm**2 * np.abs(np.linalg.det(A))) ** 2 / reach**3
    return Edges(
        middle=np.tile(points.points_px[few], (4, 1)) + radius_mm * np.einsum("nij,nj->ni", A, q),
        across=turned / steep[:, None],
        half_px=half,
        straight_px=np.minimum(half, curvature_radius),
        family=np.repeat(np.arange(4), len(few)),
        families=4,
    )


def free_of_marker(points: GridPoints) -> float:
    """Return how far from an edge, in squares, there is nothing but ink or paper."""
    target = points.target
    if target.kind != "charuco" or target.marker_mm is None:
        return _REACH
    return min(_REACH, _MARGIN * 0.5 * (1.0 - target.marker_mm / target.pitch_mm))


def thinned(members: Int[np.ndarray, " n"]) -> Int[np.ndarray, " m"]:
    """Return some of many, spread evenly."""
    if len(members) <= _PROFILES:
        return members
    return members[np.arange(_PROFILES) * len(members) // _PROFILES]


def normals(vectors: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Return the unit vectors a quarter turn from +u toward +v on."""
    turned = np.stack([-vectors[:, 1], vectors[:, 0]], axis=1)
    return np.asarray(turned / np.linalg.norm(turned, axis=1, keepdims=True))


def local_map(H: Float[np.ndarray, "3 3"], places: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2 2"]:
    """Return the plane's map at places of the target, px per mm."""
    ahead = places[:, :2] @ H[:, :2].T + H[:, 2]
    px = ahead[:, :2] / ahead[:, 2:]
    return np.asarray((H[:2, :2] - px[:, :, None] * H[2, :2]) / ahead[:, 2:, None])
