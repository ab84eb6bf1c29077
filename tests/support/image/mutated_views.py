"""Views of boards with everything wrong that a shop floor and a user may get wrong, to look for misnamed grid points.

Boards of random size, markers and pose, partly out of view, blurred, noisy, unevenly lit, behind hands, cables, paper
and reflections, soiled, with a marker pasted where it does not belong, next to or behind other boards; or not the board
that is asked for: of another size, dictionary or layout, or mirrored. A view carries the truth of every grid point, so
that a corner with a wrong name is known as such.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int, UInt8

from core.geometry.camera import Camera, project
from core.geometry.se3 import so3_exp, transform, transform_points
from core.simulation.background import background
from core.simulation.scenes import Scene
from core.targets.charuco.layout import charuco_layout, marker_dictionary
from core.targets.printed_pattern import DotPattern, RectilinearPattern, pattern_of
from core.targets.specification import GridPoints, TargetSpec
from tests.support.image import mutated_dots
from tests.support.image.view_flaws import SIZE_PX, add_occluders, mirrored, soiled, taken
from tests.support.simulation.quick_renderer import sheet_in_view

_DICTIONARIES = (
    "DICT_4X4_50",
    "DICT_4X4_1000",
    "DICT_5X5_100",
    "DICT_5X5_1000",
    "DICT_6X6_250",
    "DICT_7X7_1000",
    "DICT_ARUCO_ORIGINAL",
    "DICT_APRILTAG_16h5",
    "DICT_APRILTAG_25h9",
    "DICT_APRILTAG_36h11",
    "DICT_ARUCO_MIP_36h12",
)
_AS_STATED = 0.7  # of the views
_WRONG = 0.3  # of the spacing: a grid point farther from the truth has another one's name
_BACKGROUNDS = 8


@dataclass(frozen=True, slots=True)
class MutatedView:
    """An image, the target to ask for, and the truth.

    `points_px` (target.size, 2) are the places, row by row, of the grid points that the board in view has under the
    names of the target's; NaN where it has none: one that is found there is wrong. `is_as_stated` of views of the
    target itself, in whatever state. `changes` name what was done.
    """

    image: UInt8[np.ndarray, "h w"]
    target: TargetSpec
    points_px: Float[np.ndarray, "n 2"]
    is_as_stated: bool
    changes: tuple[str, ...]

    def wrong(self, found: GridPoints) -> int:
        """Return how many grid points were found under a wrong name.

        A rectangle of dots has the same places in a mirror. Where its larger dot is hidden, nothing is wrong in saying
        that either end may be the origin; in naming one, all is.
        """
        if "mirrored" in self.changes and found.labelling == "absolute":
            return len(found)
        return min(self._misnamed(found.points_px, *cells) for cells in mutated_dots.readings(found))

    def _misnamed(
        self,
        points_px: Float[np.ndarray, "n 2"],
        column: Int[np.ndarray, " n"],
        row: Int[np.ndarray, " n"],
    ) -> int:
        grid = self.points_px.reshape(-1, self.target.grid_columns, 2)
        apart = [np.linalg.norm(np.diff(grid, axis=axis), axis=2) for axis in range(2)]
        usual = min(float(np.nanmedian(steps)) if np.isfinite(steps).any() else np.inf for steps in apart)
        down, across = (np.where(np.isfinite(steps), steps, usual) for steps in apart)
        near = np.full(grid.shape[:2], usual)
        for steps, before, after in ((down, np.s_[1:], np.s_[:-1]), (across, np.s_[:, 1:], np.s_[:, :-1])):
            near[before] = np.minimum(near[before], steps)
            near[after] = np.minimum(near[after], steps)
        has = (column >= 0) & (column < grid.shape[1]) & (row >= 0) & (row < grid.shape[0])
        off = np.linalg.norm(points_px[has] - grid[row[has], column[has]], axis=1)
        return len(points_px) - int(np.count_nonzero(off < _WRONG * near[row[has], column[has]]))


def mutated_views(seed: int, kind: str = "charuco") -> Iterator[MutatedView]:
    """Yield mutated views without end, of a kind with markers or of dots; the same ones for the same seed."""
    number = 0
    while True:
        yield mutated_view(seed, number, kind)
        number += 1


def mutated_view(seed: int, number: int, kind: str = "charuco") -> MutatedView:
    """Return the view of that number among a seed's."""
    rng = np.random.default_rng([seed, number, 9283])
    printed = _draw_target(rng, kind)
    origin_dot = mutated_dots.draw_origin_dot(rng, printed) if kind in mutated_dots.KINDS else 1.0
    stated, changes = (printed, []) if rng.random() < _AS_STATED else _misstated(rng, printed, origin_dot)
    is_as_stated = not changes
    sheet = soiled(rng, pattern_of(printed, float(rng.uniform(0.2, 1.5)), origin_dot), printed, changes)
    camera = _draw_camera(rng)
    T_camera_target = _draw_pose(rng, printed, camera, strays=is_as_stated)
    T_camera_sheet = T_camera_target
    if "mirrored" in changes and isinstance(sheet, RectilinearPattern):
        sheet = mirrored(sheet)
    elif "mirrored" in changes:
        T_camera_sheet = T_camera_target @ np.diag([-1.0, 1.0, 1.0, 1.0])
        T_camera_sheet[:3, 3] += T_camera_target[:3, 0] * float(sheet.x_edges[0] + sheet.x_edges[-1])
    levels = _backgrounds(seed)[int(rng.integers(_BACKGROUNDS))].copy()
    if is_as_stated and rng.random() < 0.35:
        _add_another(rng, levels, printed, stated, camera, changes)
    dark, bright = float(rng.uniform(5, 60)), float(rng.uniform(120, 245))
    if kind in mutated_dots.KINDS and rng.random() < 0.2:
        dark, bright = bright, dark
    _lay(levels, sheet, camera, T_camera_sheet, dark, bright)
    points = project(transform_points(T_camera_target, printed.points_target()), camera)
    if is_as_stated:
        add_occluders(rng, levels, points, changes)
    if kind in mutated_dots.KINDS:
        mutated_dots.add_blots(rng, levels, points, changes)
    image = taken(rng, levels, points, changes)
    return MutatedView(image, stated, _named(stated, printed, points, changes), is_as_stated, tuple(changes))


def _draw_target(rng: np.random.Generator, kind: str) -> TargetSpec:
    """Return a board of random size that its dictionary has enough markers for."""
    if kind == "aprilgrid":
        columns, rows = (int(n) for n in rng.integers(3, 8, 2))
        return TargetSpec(kind, columns, rows, 30.0, 30.0 / (1.0 + float(rng.uniform(0.2, 0.4))))
    if kind in mutated_dots.KINDS:
        return mutated_dots.draw_dots(rng, kind)
    while True:
        columns, rows = int(rng.integers(3, 15)), int(rng.integers(3, 11))
        target = TargetSpec(
            kind,
            columns,
            rows,
            30.0,
            30.0 * float(rng.uniform(0.5, 0.8)),
            str(rng.choice(_DICTIONARIES)),
            legacy_layout=bool(rng.random() < 0.3),
        )
        if _has_markers(target):
            return target


def _has_markers(target: TargetSpec) -> bool:
    squares = (target.columns + 1) * (target.rows + 1)
    return len(marker_dictionary(target).bytesList) >= (squares + 1) // 2


def _misstated(
    rng: np.random.Generator, printed: TargetSpec, origin_dot: float
) -> tuple[TargetSpec, list[str]]:
    """Return another target than the one printed, and how they differ."""
    kinds = ["mirrored", "size", "size"]
    if printed.kind in mutated_dots.KINDS and not mutated_dots.differs_in_a_mirror(printed, origin_dot):
        kinds = ["size"]
    if printed.kind == "charuco":
        kinds += ["dictionary", "marker_size"] + ["layout"] * (printed.rows % 2)
    change = str(rng.choice(kinds))
    while change == "size":
        columns, rows = printed.columns + int(rng.integers(-2, 3)), printed.rows + int(rng.integers(-2, 3))
        stated = replace(printed, columns=max(columns, 3), rows=max(rows, 3))
        is_another = stated != printed
        if printed.kind in mutated_dots.KINDS:
            is_another = not (
                mutated_dots.may_show(stated, printed) and mutated_dots.may_show(printed, stated)
            )
        if is_another and (printed.kind != "charuco" or _has_markers(stated)):
            return stated, ["size"]
    while change == "dictionary":
        stated = replace(printed, dictionary=str(rng.choice(_DICTIONARIES)))
        if _has_markers(stated) and not _same_markers(stated, printed):
            return stated, ["dictionary"]
    if change == "layout":
        return replace(printed, legacy_layout=not printed.legacy_layout), ["layout"]
    if change == "marker_size":
        return replace(printed, marker_mm=float(rng.uniform(0.5, 0.8)) * printed.pitch_mm), ["marker_size"]
    return printed, ["mirrored"]


def _same_markers(one: TargetSpec, other: TargetSpec) -> bool:
    """Return whether two boards of one size have the same markers: a small dictionary begins the larger ones."""
    return np.array_equal(charuco_layout(one).marker_cells, charuco_layout(other).marker_cells)


def _named(
    stated: TargetSpec, printed: TargetSpec, points: Float[np.ndarray, "n 2"], changes: list[str]
) -> Float[np.ndarray, "m 2"]:
    """Return the printed board's grid points under the stated one's names."""
    named = np.full((stated.grid_rows, stated.grid_columns, 2), np.nan)
    if ("mirrored" not in changes or printed.kind == "circles") and "dictionary" not in changes:
        grid = points.reshape(printed.grid_rows, printed.grid_columns, 2)
        rows, columns = (min(a, b) for a, b in zip(named.shape[:2], grid.shape[:2], strict=True))
        named[:rows, :columns] = grid[:rows, :columns]
    return named.reshape(-1, 2)


def _draw_camera(rng: np.random.Generator) -> Camera:
    f = float(rng.uniform(700.0, 2000.0))
    middle = rng.normal(0.5, 0.01, 2) * SIZE_PX
    return Camera(f, f, float(middle[0]), float(middle[1]), k1=float(rng.uniform(-0.25, 0.05)), k2=0.05)


def _draw_pose(
    rng: np.random.Generator, target: TargetSpec, camera: Camera, *, strays: bool
) -> Float[np.ndarray, "4 4"]:
    """Return a random pose, any way up; one that `strays` may have much of the board out of the image."""
    points = target.points_target()
    middle, extent = 0.5 * (points.min(axis=0) + points.max(axis=0)), float(np.max(np.ptp(points, axis=0)))
    axis, tilt = rng.uniform(0.0, 2.0 * math.pi), math.radians(rng.uniform(0.0, 60.0))
    R = so3_exp(tilt * np.array([math.cos(axis), math.sin(axis), 0.0]))
    R = R @ so3_exp(np.array([0.0, 0.0, rng.uniform(-math.pi, math.pi)]))
    wide_px = rng.uniform(250.0, 1100.0) if strays else rng.uniform(300.0, 550.0)
    depth = max(camera.fx_px * extent / wide_px, 1.5 * extent)
    reach = 0.45 if strays else 0.1
    offset = rng.uniform(-reach, reach, 2) * SIZE_PX * depth / camera.fx_px
    return transform(R, np.array([*offset, depth]) - R @ middle)


def _lay(
    levels: Float[np.ndarray, "h w"],
    sheet: RectilinearPattern | DotPattern,
    camera: Camera,
    T_camera_target: Float[np.ndarray, "4 4"],
    dark: float,
    bright: float,
) -> None:
    """Lay a sheet over what is in the image."""
    ink, seen = sheet_in_view(sheet, camera, T_camera_target, SIZE_PX)
    levels *= 1.0 - seen
    levels += dark * seen + (bright - dark) * ink


def _add_another(
    rng: np.random.Generator,
    levels: Float[np.ndarray, "h w"],
    printed: TargetSpec,
    stated: TargetSpec,
    camera: Camera,
    changes: list[str],
) -> None:
    """Lay another board into the image, behind the one to come; never the same one, nor the one asked for."""
    other = _draw_target(rng, printed.kind)
    while other.kind == "aprilgrid" and other.columns in (printed.columns, stated.columns):
        other = _draw_target(rng, printed.kind)  # of sheets of equal width one is the upper part of the other
    if rng.random() < 0.4:
        other = replace(printed, kind="chessboard", dictionary=None, marker_mm=None)
    elif printed.kind == "charuco" and rng.random() < 0.5:
        wider = replace(printed, columns=max(3, printed.columns + int(rng.choice([-2, -1, 1, 2]))))
        other = wider if wider != printed and _has_markers(wider) else other
    elif printed.kind in mutated_dots.KINDS and printed.columns > 3 and rng.random() < 0.5:
        other = replace(printed, columns=max(3, printed.columns - int(rng.integers(1, 3))))
    if printed.kind in mutated_dots.KINDS and mutated_dots.may_show(other, stated):
        other = replace(printed, kind="chessboard", marker_mm=None)
    T = _draw_pose(rng, other, camera, strays=True)
    sheet = pattern_of(other, float(rng.uniform(0.2, 1.5)))
    _lay(levels, sheet, camera, T, float(rng.uniform(5, 60)), float(rng.uniform(120, 245)))
    changes.append(f"next_to_{other.kind}")


@lru_cache(maxsize=2)
def _backgrounds(seed: int) -> list[Float[np.ndarray, "h w"]]:
    """Return what lies behind the boards of a seed's views."""
    nothing = TargetSpec("chessboard", 3, 3, 30.0)
    camera = Camera(1000.0, 1000.0, 500.0, 400.0)
    return [
        background(
            Scene(
                nothing,
                camera,
                np.eye(4),
                *SIZE_PX,
                clutter=float(k % 4) / 3.0,
                background_seed=seed * 100 + k,
            )
        )
        for k in range(_BACKGROUNDS)
    ]
