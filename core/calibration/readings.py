"""Which way round a board was read: one choice over all images of a board that looks the same when turned.

Such a board is read with its x axis toward the image's right, image by image. Between images of a camera that turned
past the vertical the reading flips, and with it the target frame, by a turn of the whole grid. The points are the same
ones under other names, so that another reading of an estimated pose needs no new fit: with S the turn of the grid in
the target frame, T_target_camera becomes S⁻¹ T_target_camera.

Images of one pose differ by the robot's repeatability, far less than a turn: they follow the pose's first image. Poses
follow one another by the commanded orientations where these are known: the camera sits fixed on the flange, so that the
angle between two poses is the same for flange and camera, whatever the mounting. Elsewhere the least turn between poses
is taken, which is a guess.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.targets.specification import TargetSpec
from core.transforms import transform

CLEAR = math.radians(10.0)
"""Commanded orientations decide where they are nearer to one reading than to the next by this much."""
BOLD = math.radians(60.0)
"""The least turn is no sound guess where it is more than this or the next reading is within `CLEAR` of it."""


@dataclass(frozen=True, slots=True)
class Readings:
    """The turn chosen for each image, as an index into `turns_alike`; whether commanded orientations decided every one
    between poses; and the poses whose turn against the others is a guess that another reading comes close to.
    """

    turns: Int[np.ndarray, " k"]
    by_commands: bool
    doubtful: tuple[Hashable, ...]


def turns_alike(target: TargetSpec) -> Float[np.ndarray, "turns 4 4"]:
    """Return the turns of the target frame, the identity first, after which the grid looks the same."""
    columns, rows = target.columns, target.rows
    half = {
        "chessboard": (columns + rows) % 2 == 0,
        "circles": True,
        "asymmetric_circles": rows % 2 == 0,
    }.get(target.kind, False)
    quarter = columns == rows and (
        target.kind == "circles" or (target.kind == "chessboard" and columns % 2 == 0)
    )
    steps = (0, 1, 2, 3) if quarter else (0, 2) if half else (0,)
    corners = target.points_target()
    centre = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    turns = []
    for step in steps:
        cosine, sine = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[step]
        rotation = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        turns.append(transform(rotation, centre - rotation @ centre))
    return np.array(turns)


def choose_readings(
    rotations: Float[np.ndarray, "k 3 3"],
    poses: Sequence[Hashable],
    turns: Float[np.ndarray, "turns 4 4"],
    commanded: Mapping[Hashable, Float[np.ndarray, "3 3"]],
) -> Readings:
    """Choose a turn for every image.

    Parameters: `rotations` are R_target_camera as read, `poses` names the pose of each image, `commanded` holds
    R_base_flange of the poses for which it is known.
    """
    back = np.swapaxes(turns[:, :3, :3], 1, 2)
    first_of: dict[Hashable, int] = {}
    for i, pose in enumerate(poses):
        first_of.setdefault(pose, i)
    names, first = list(first_of), list(first_of.values())
    place = {name: i for i, name in enumerate(names)}
    of_pose = np.array([place[pose] for pose in poses])
    candidates = np.einsum("tij,pjk->ptik", back, rotations[first])
    settled = _settle(candidates, [commanded.get(name) for name in names])
    products = _products(turns)
    # The turn after which an image is nearest to its pose's first: the smallest angle, so the largest trace.
    relative = rotations @ np.swapaxes(rotations[first][of_pose], 1, 2)
    nearest = np.argmax(np.einsum("tij,kji->kt", back, relative), axis=1)
    chosen = products[settled.turn[of_pose], nearest]
    doubtful = tuple(name for name, sure in zip(names, settled.sure, strict=True) if not sure)
    return Readings(chosen, settled.by_commands, doubtful)


@dataclass(frozen=True, slots=True)
class _Settled:
    turn: Int[np.ndarray, " p"]
    sure: list[bool]
    by_commands: bool


def _settle(
    candidates: Float[np.ndarray, "p turns 3 3"], commanded: Sequence[Float[np.ndarray, "3 3"] | None]
) -> _Settled:
    """Settle one pose after another, the clearest first, since each settled one makes the others clearer."""
    count, turns = candidates.shape[:2]
    known = np.array([R is not None for R in commanded])
    told = np.array([np.eye(3) if R is None else R for R in commanded])
    turn = np.zeros(count, dtype=np.intp)
    sure = [True] * count
    by_commands = True
    misfit = np.zeros((count, turns))  # of angles to the settled poses, seen and commanded
    compared = 0
    least = np.full((count, turns), np.inf)  # turn to the nearest settled pose
    newest = int(np.argmax(known))
    open_poses = np.ones(count, dtype=np.bool_)
    for _ in range(count - 1):
        open_poses[newest] = False
        reference = candidates[newest, turn[newest]]
        seen = _angles(candidates.reshape(-1, 3, 3), reference).reshape(count, turns)
        least = np.minimum(least, seen)
        if known[newest]:
            misfit += (seen - _angles(told, told[newest])[:, None]) ** 2
            compared += 1
        by_angle = _margin(np.sqrt(misfit / max(compared, 1)))
        clear = open_poses & known & (by_angle > CLEAR) & (compared > 0)
        if clear.any():
            newest = int(np.argmax(np.where(clear, by_angle, -np.inf)))
            turn[newest] = int(np.argmin(misfit[newest]))
        else:
            by_commands = False
            by_turn = _margin(least)
            newest = int(np.argmax(np.where(open_poses, by_turn, -np.inf)))
            turn[newest] = int(np.argmin(least[newest]))
            sure[newest] = bool(by_turn[newest] > CLEAR and least[newest].min() < BOLD)
    return _Settled(turn, sure, by_commands)


def _margin(distance: Float[np.ndarray, "p turns"]) -> Float[np.ndarray, " p"]:
    """Return by how much the best is better than the next."""
    ordered = np.sort(distance, axis=1)
    return np.asarray(ordered[:, 1] - ordered[:, 0])


def _angles(
    rotations: Float[np.ndarray, "n 3 3"], reference: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, " n"]:
    """Return the angle of each Rᵀ R_reference."""
    cosine = 0.5 * (np.einsum("nij,ij->n", rotations, reference) - 1.0)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _products(turns: Float[np.ndarray, "turns 4 4"]) -> Int[np.ndarray, "turns turns"]:
    """Return the index of the turn that amounts to one turn after another."""
    rotations = turns[:, :3, :3]
    table = np.empty((len(turns), len(turns)), dtype=np.intp)
    for i, first in enumerate(rotations):
        for j, second in enumerate(rotations):
            table[i, j] = int(np.argmin(_angles(rotations, first @ second)))
    return table
