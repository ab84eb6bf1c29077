"""Orientation of a symmetric board: one choice over all images of a board that looks the same when turned.

Such a board is read with its x axis toward the image's right, image by image. Between images of a camera that turned
past the vertical the reading flips, and with it the target frame, by a turn of the whole grid. The points are the same
ones under other labels, so that another reading of an estimated pose needs no new fit: with S the turn of the grid in
the target frame, T_target_camera becomes S⁻¹ T_target_camera.

Images of one pose differ by the robot's repeatability, far less than a turn: they follow the pose's first image. An
image that determines the board's orientation (`GridPoints.labelling` "absolute") is never turned; its pose follows
it, and all other poses begin there. Poses follow one another by the commanded orientations where these are known: the
camera sits fixed on the flange, so that the angle between two poses is the same for flange and camera, whatever the
mounting. Elsewhere the least turn between poses is taken, which is a guess.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.multi_view.view_stack import ViewStack, evenly
from core.geometry import transform
from core.targets import TargetSpec

MIN_ANGLE_MARGIN = math.radians(10.0)
"""Commanded orientations decide where they are nearer to one reading than to the next by this much."""
MAX_GUESSED_TURN = math.radians(60.0)
"""A least turn above this, or with the next reading within `MIN_ANGLE_MARGIN` of it, is not a sound guess."""
MAX_DISTANCE_RATIO = 0.5
"""Mean distance of equally labelled points by the matching turn, of that by the next best one, for it to be clear."""
MIN_POSES_TO_CONTRADICT = 4
"""Commanded poses from which on one of them can be said to contradict the others."""
MAX_REFERENCES = 256
"""Settled poses of one round that the open ones are compared with, evenly chosen from all of them."""


@dataclass(frozen=True, slots=True)
class OrientationChoice:
    """The turn chosen for each image, as an index into `symmetry_rotations`.

    `settled` is true if commanded orientations or images that show their origin decided every turn between poses.
    `ambiguous` are the poses whose turn against the others is a guess that another reading comes close to,
    `contradicting` those whose commanded orientation fits none of the readings, and `unclear` the images that no
    reading brings clearly nearest to the first of their pose: they show another orientation than it.
    """

    turns: Int[np.ndarray, " k"]
    settled: bool
    ambiguous: tuple[Hashable, ...]
    contradicting: tuple[Hashable, ...]
    unclear: Bool[np.ndarray, " k"]


def quarter_turns(target: TargetSpec) -> tuple[int, ...]:
    """Return by how many quarter turns the grid may be turned and look the same, 0 first; by the target's kind alone:
    fiducial dots or a larger origin dot may still identify the turn (`GridPoints.labelling`).
    """
    columns, rows = target.columns, target.rows
    half = {
        "chessboard": (columns + rows) % 2 == 0,
        "circles": True,
        "asymmetric_circles": rows % 2 == 0,
    }.get(target.kind, False)
    quarter = columns == rows and (
        target.kind == "circles" or (target.kind == "chessboard" and columns % 2 == 0)
    )
    return (0, 1, 2, 3) if quarter else (0, 2) if half else (0,)


def turned_cells(
    target: TargetSpec, column: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"], quarters: int
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Return the labels of grid points after so many quarter turns, under which the grid must look the same."""
    last_column, last_row = target.columns - 1, target.rows - 1
    return (
        (column, row),
        (last_row - row, column),
        (last_column - column, last_row - row),
        (row, last_column - column),
    )[quarters]


def nearest_turn(views: ViewStack, reference: int, image: int) -> int | None:
    """Return the quarter turns of the target frame that bring an image's points nearest to those of another image of
    the same pose with the same labels.

    Images of one pose show each grid point within the robot's scatter of one pixel. None where no turn brings the
    points much nearer than the next best one, or the images have too few points in common.
    """
    target = views.targets[int(views.target[image])]
    grid = np.full((target.grid_rows, target.grid_columns, 2), np.nan)
    at = views.part(reference)
    grid[views.row[at], views.column[at]] = views.points_px[at]
    at = views.part(image)
    turns, distances = quarter_turns(target), []
    for quarters in turns:
        column, row = turned_cells(target, views.column[at], views.row[at], -quarters % 4)
        distance = np.linalg.norm(views.points_px[at] - grid[row, column], axis=1)
        common = np.isfinite(distance)
        if 2 * np.count_nonzero(common) <= len(distance):
            return None
        distances.append(float(distance[common].mean()))
    order = np.argsort(distances)
    if len(order) > 1 and distances[order[0]] > MAX_DISTANCE_RATIO * distances[order[1]]:
        return None
    return turns[int(order[0])]


def symmetry_rotations(target: TargetSpec) -> Float[np.ndarray, "turns 4 4"]:
    """Return the turns of the target frame, the identity first, after which the grid looks the same."""
    corners = target.points_target()
    centre = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    turns = []
    for step in quarter_turns(target):
        cosine, sine = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[step]
        rotation = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        turns.append(transform(rotation, centre - rotation @ centre))
    return np.array(turns)


def resolve_symmetry(
    rotations: Float[np.ndarray, "k 3 3"],
    poses: Sequence[Hashable],
    turns: Float[np.ndarray, "turns 4 4"],
    commanded: Mapping[Hashable, Float[np.ndarray, "3 3"]],
    known: Sequence[bool] | None = None,
) -> OrientationChoice:
    """Choose a turn for every image.

    Parameters: `rotations` are R_target_camera as read, `poses` names the pose of each image, `commanded` holds
    R_base_flange of the poses for which it is known, `known` is true for each image that shows its origin.
    """
    sure = np.zeros(len(poses), dtype=np.bool_) if known is None else np.asarray(known, dtype=np.bool_)
    back = np.swapaxes(turns[:, :3, :3], 1, 2)
    first_of: dict[Hashable, int] = {}
    for i, pose in enumerate(poses):
        first = first_of.setdefault(pose, i)
        if sure[i] and not sure[first]:
            first_of[pose] = i
    names, first_images = list(first_of), np.array(list(first_of.values()), dtype=np.intp)
    place = {name: i for i, name in enumerate(names)}
    of_pose = np.array([place[pose] for pose in poses], dtype=np.intp)
    candidates = np.einsum("tij,pjk->ptik", back, rotations[first_images])
    settled = _settle(candidates, [commanded.get(name) for name in names], sure[first_images])
    products = _products(turns)
    # The turn after which an image is nearest to its pose's first: the smallest angle, so the largest trace.
    relative = rotations @ np.swapaxes(rotations[first_images][of_pose], 1, 2)
    traces = np.einsum("tij,kji->kt", back, relative)
    nearest = np.argmax(traces, axis=1)
    chosen = np.where(sure, 0, products[settled.turn[of_pose], nearest])
    to_first = np.arccos(np.clip(0.5 * (traces - 1.0), -1.0, 1.0))
    return OrientationChoice(
        chosen,
        settled.by_evidence,
        tuple(name for name, one in zip(names, settled.sure, strict=True) if not one),
        tuple(name for name, one in zip(names, settled.contradicting.tolist(), strict=True) if one),
        ~sure & (_margin(to_first) < MIN_ANGLE_MARGIN),
    )


@dataclass(frozen=True, slots=True)
class _Settled:
    turn: Int[np.ndarray, " p"]
    sure: list[bool]
    by_evidence: bool
    contradicting: Bool[np.ndarray, " p"]


def _settle(
    candidates: Float[np.ndarray, "p turns 3 3"],
    commanded: Sequence[Float[np.ndarray, "3 3"] | None],
    fixed: Bool[np.ndarray, " p"],
) -> _Settled:
    """Choose the turns of the poses in rounds, those of the largest margin first: settled poses increase the margins of
    the others. A round settles no more poses than are settled already. The `fixed` poses are settled as they were read;
    without any, the first that was commanded is.
    """
    count, turns = candidates.shape[:2]
    known = np.array([R is not None for R in commanded])
    rotations = np.array([np.eye(3) if R is None else R for R in commanded])
    turn = np.zeros(count, dtype=np.intp)
    sure = np.ones(count, dtype=np.bool_)
    by_evidence = True
    misfit = np.zeros((count, turns))  # of angles to the settled poses, seen and commanded
    compared = 0
    least = np.full((count, turns), np.inf)  # turn to the nearest settled pose
    newest = np.flatnonzero(fixed) if fixed.any() else np.array([int(np.argmax(known))])
    open_poses = np.ones(count, dtype=np.bool_)
    flat = candidates.reshape(-1, 9)
    while True:
        open_poses[newest] = False
        references = np.array(evenly(newest.tolist(), MAX_REFERENCES))
        at = candidates[references, turn[references]].reshape(-1, 9)
        seen = _angles(flat, at).reshape(count, turns, -1)
        least = np.minimum(least, seen.min(axis=2))
        if known[references].any():
            of_flange = _angles(
                rotations.reshape(-1, 9), rotations[references[known[references]]].reshape(-1, 9)
            )
            misfit += np.sum((seen[:, :, known[references]] - of_flange[:, None]) ** 2, axis=2)
            compared += int(known[references].sum())
        if not open_poses.any():
            break
        by_angle = _margin(np.sqrt(misfit / max(compared, 1)))
        clear = open_poses & known & (by_angle > MIN_ANGLE_MARGIN) & (compared > 0)
        most = max(1, count - int(open_poses.sum()))
        if clear.any():
            newest = _clearest(by_angle, clear, most)
            turn[newest] = np.argmin(misfit[newest], axis=1)
            continue
        by_evidence = False
        by_turn = _margin(least)
        sound = open_poses & (by_turn > MIN_ANGLE_MARGIN) & (least.min(axis=1) < MAX_GUESSED_TURN)
        newest = _clearest(by_turn, sound, most) if sound.any() else _clearest(by_turn, open_poses, 1)
        turn[newest] = np.argmin(least[newest], axis=1)
        sure[newest] = sound[newest]
    return _Settled(turn, sure.tolist(), by_evidence, _contradicting(candidates, turn, rotations, known))


def _contradicting(
    candidates: Float[np.ndarray, "p turns 3 3"],
    turn: Int[np.ndarray, " p"],
    rotations: Float[np.ndarray, "p 3 3"],
    known: Bool[np.ndarray, " p"],
) -> Bool[np.ndarray, " p"]:
    """Return which poses' angles to the others differ between seen and commanded, by the median, which is robust
    against a few wrong poses among the others.
    """
    result = np.zeros(len(turn), dtype=np.bool_)
    among = np.flatnonzero(known)
    if len(among) < MIN_POSES_TO_CONTRADICT:
        return result
    references = np.array(evenly(among.tolist(), MAX_REFERENCES))
    seen = candidates[np.arange(len(turn)), turn].reshape(-1, 9)
    of_flange = rotations.reshape(-1, 9)
    off = np.abs(_angles(seen[among], seen[references]) - _angles(of_flange[among], of_flange[references]))
    result[among] = np.median(off, axis=1) > MIN_ANGLE_MARGIN
    return result


def _clearest(
    margin: Float[np.ndarray, " p"], of: Bool[np.ndarray, " p"], most: int
) -> Int[np.ndarray, " n"]:
    """Return at most `most` of the poses, those of the largest margins."""
    order = np.argsort(np.where(of, -margin, np.inf), kind="stable")
    return order[: min(most, int(of.sum()))]


def _margin(distance: Float[np.ndarray, "p turns"]) -> Float[np.ndarray, " p"]:
    """Return by how much the best is better than the next; without bounds where there is but one."""
    if distance.shape[1] == 1:
        return np.full(len(distance), np.inf)
    ordered = np.sort(distance, axis=1)
    return np.asarray(ordered[:, 1] - ordered[:, 0])


def _angles(one: Float[np.ndarray, "n 9"], other: Float[np.ndarray, "m 9"]) -> Float[np.ndarray, "n m"]:
    """Return the angles of Rᵀ R' between rotations written out in rows of nine."""
    return np.asarray(np.arccos(np.clip(0.5 * (one @ other.T - 1.0), -1.0, 1.0)))


def _products(turns: Float[np.ndarray, "turns 4 4"]) -> Int[np.ndarray, "turns turns"]:
    """Return the index of the turn that equals one turn after another."""
    rotations = turns[:, :3, :3]
    table = np.empty((len(turns), len(turns)), dtype=np.intp)
    for i, first in enumerate(rotations):
        for j, second in enumerate(rotations):
            table[i, j] = int(np.argmax(np.einsum("nij,ij->n", rotations, first @ second)))
    return table
