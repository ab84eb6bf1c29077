"""Many views in one set of arrays: their grid points end to end, and their states.

A pass over thousands of images is one compiled loop.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.residuals import View
from core.errors import InvalidArgument
from core.geometry import free_parameters, rotations_from_vectors
from core.jit import jit
from core.targets import GridPoints, TargetSpec

T = TypeVar("T")


@dataclass(frozen=True)
class ViewStack:
    """Grid points of m images of one size; those of image i stand at first[i] to first[i + 1] of every array over
    points. `target` is each image's place in `targets`; `points_target` are in its frame, mm.
    """

    image_width_px: int
    image_height_px: int
    targets: tuple[TargetSpec, ...]
    target: Int[np.ndarray, " m"]
    first: Int[np.ndarray, " bounds"]
    column: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]
    points_px: Float[np.ndarray, "n 2"]
    standard_uncertainty_px: Float[np.ndarray, " n"]
    points_target: Float[np.ndarray, "n 3"]

    def __len__(self) -> int:
        return len(self.target)

    @cached_property
    def counts(self) -> Int[np.ndarray, " m"]:
        """Points of each image."""
        return np.diff(self.first)

    @cached_property
    def centroids(self) -> Float[np.ndarray, "m 3"]:
        """The mean of each image's points in its target's frame, mm; turning about it decouples rotation from
        translation.
        """
        return self.sums(self.points_target) / np.maximum(self.counts, 1)[:, None]

    @cached_property
    def weight(self) -> Float[np.ndarray, " n"]:
        """1/u² of each point."""
        return 1.0 / self.standard_uncertainty_px**2

    @cached_property
    def median_weight(self) -> Float[np.ndarray, " m"]:
        """The median of each image's weights."""
        return medians(self.weight, self.first)

    @cached_property
    def cell(self) -> Int[np.ndarray, " n"]:
        """Each point's place in its target, row by row."""
        columns = np.array([t.grid_columns for t in self.targets], dtype=np.intp)[self.target]
        return self.row * self.spread(columns) + self.column

    @cached_property
    def uncertainty(self) -> Float[np.ndarray, " m"]:
        """The mean of each image's stated uncertainties, px."""
        return self.sums(self.standard_uncertainty_px) / np.maximum(self.counts, 1)

    def spread(self, of_views: np.ndarray) -> np.ndarray:
        """Return a value of each image at each of its points."""
        return np.repeat(of_views, self.counts, axis=0)

    def sums(self, of_points: np.ndarray) -> np.ndarray:
        """Return the sum of a value over each image's points."""
        return segment_sums(of_points, self.first)

    def part(self, i: int) -> slice:
        """Return where the points of image i stand."""
        return slice(int(self.first[i]), int(self.first[i + 1]))

    def centred(
        self, i: int, points: slice | Int[np.ndarray, " p"]
    ) -> tuple[Float[np.ndarray, "3 p"], Float[np.ndarray, "2 p"]]:
        """Return points of image i about its centroid (target frame, mm), and where they were observed (px)."""
        return (
            np.ascontiguousarray((self.points_target[points] - self.centroids[i]).T),
            np.ascontiguousarray(self.points_px[points].T),
        )

    def view(self, i: int) -> GridPoints:
        """Return the grid points of one image."""
        at = self.part(i)
        return GridPoints(
            target=self.targets[int(self.target[i])],
            image_width_px=self.image_width_px,
            image_height_px=self.image_height_px,
            column=self.column[at],
            row=self.row[at],
            points_px=self.points_px[at],
            standard_uncertainty_px=self.standard_uncertainty_px[at],
            measured_points_target=self.points_target[at],
        )

    def take(self, images: Sequence[int] | Int[np.ndarray, " k"]) -> ViewStack:
        """Return some of the images, in the order given."""
        chosen = np.asarray(images, dtype=np.intp)
        if np.array_equal(chosen, np.arange(len(self))):
            return self
        counts = self.counts[chosen]
        first = np.concatenate([[0], np.cumsum(counts)])
        points = np.arange(first[-1]) + np.repeat(self.first[chosen] - first[:-1], counts)
        return ViewStack(
            self.image_width_px,
            self.image_height_px,
            self.targets,
            self.target[chosen],
            first,
            self.column[points],
            self.row[points],
            self.points_px[points],
            self.standard_uncertainty_px[points],
            self.points_target[points],
        )


def stack_views(views: Sequence[GridPoints], prints: Sequence[int] | None = None) -> ViewStack:
    """Put views of one image size end to end.

    `prints` says which print each view shows; without it, views of one description show one print.

    Raises InvalidArgument for no views and for mixed image sizes.
    """
    if not views:
        raise InvalidArgument("At least one view is needed.")
    if len({(v.image_width_px, v.image_height_px) for v in views}) > 1:
        raise InvalidArgument(
            "The images of one focus group have different sizes.",
            "Give every camera setting a focus group of its own.",
        )
    of_views = number_labels([v.target for v in views] if prints is None else prints)
    targets: dict[int, TargetSpec] = {}
    places: dict[tuple[int, bytes, bytes], Float[np.ndarray, "n 3"]] = {}
    located = []
    for target, v in zip(of_views.tolist(), views, strict=True):
        targets.setdefault(target, v.target)
        if v.measured_points_target is not None:
            located.append(v.measured_points_target)
            continue
        key = (target, v.column.tobytes(), v.row.tobytes())
        if key not in places:
            places[key] = v.points_target
        located.append(places[key])
    return ViewStack(
        views[0].image_width_px,
        views[0].image_height_px,
        tuple(targets.values()),
        of_views,
        np.concatenate([[0], np.cumsum([len(v) for v in views])]),
        np.concatenate([v.column for v in views]),
        np.concatenate([v.row for v in views]),
        np.concatenate([v.points_px for v in views]),
        np.concatenate([v.standard_uncertainty_px for v in views]),
        np.concatenate(located),
    )


def number_labels(labels: Iterable[Hashable]) -> Int[np.ndarray, " m"]:
    """Return labels as numbers from 0 on, in the order of their first appearance."""
    places: dict[Hashable, int] = {}
    return np.array([places.setdefault(label, len(places)) for label in labels], dtype=np.intp)


def evenly(items: list[T], count: int) -> list[T]:
    """Return `count` of the items, from the first to the last, or all where there are no more."""
    if len(items) <= count:
        return items
    return [items[k] for k in np.linspace(0, len(items) - 1, count).astype(np.intp).tolist()]


def groups_of(numbers: Int[np.ndarray, " m"]) -> list[Int[np.ndarray, " _"]]:
    """Return the places of each number, those of the lowest first, ascending."""
    order = np.argsort(numbers, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(numbers[order])) + 1) if len(order) else []


def segment_sums(values: np.ndarray, first: Int[np.ndarray, " bounds"]) -> np.ndarray:
    """Return the sums of values[first[i]:first[i + 1]]; 0 for empty segments."""
    m = len(first) - 1
    sums = np.zeros((m, *values.shape[1:]))
    some = first[1:] > first[:-1]
    if some.any():
        sums[some] = np.add.reduceat(values, first[:-1][some], axis=0)
    return sums


@jit("f8[::1], i8[::1]")
def medians(values: Float[np.ndarray, " n"], first: Int[np.ndarray, " bounds"]) -> Float[np.ndarray, " m"]:
    """Return the median of values[first[i]:first[i + 1]]; 0 for empty segments."""
    result = np.zeros(len(first) - 1)
    for i in range(len(result)):
        begin, end = first[i], first[i + 1]
        if end == begin:
            continue
        same = True
        for k in range(begin + 1, end):
            if values[k] != values[begin]:
                same = False
                break
        result[i] = values[begin] if same else np.median(values[begin:end])
    return result


@dataclass(frozen=True, slots=True)
class Placements:
    """The states of many views (`model.View`), one row each."""

    parameters: Float[np.ndarray, "m s"]
    rotations: Float[np.ndarray, "m 3 3"]
    translations_mm: Float[np.ndarray, "m 3"]

    def __len__(self) -> int:
        return len(self.parameters)

    @property
    def free(self) -> int:
        """How many of the camera's parameters are estimated, the first ones."""
        return free_parameters(self.parameters.shape[1])

    def view(self, i: int) -> View:
        return View(self.parameters[i], self.rotations[i], self.translations_mm[i])

    def take(self, images: Sequence[int] | Int[np.ndarray, " k"] | Bool[np.ndarray, " m"]) -> Placements:
        """Return the states of some of the views."""
        return Placements(self.parameters[images], self.rotations[images], self.translations_mm[images])


def stack_states(views: Sequence[View]) -> Placements:
    """Put states one below the other."""
    return Placements(
        np.array([v.parameters for v in views]),
        np.array([v.rotation for v in views]),
        np.array([v.translation_mm for v in views]),
    )


def coordinates(parameters: Float[np.ndarray, " s"]) -> Float[np.ndarray, "c c"]:
    """Return the derivatives of the free camera parameters by the step's coordinates."""
    fx, fy = float(parameters[0]), float(parameters[1])
    change = np.eye(free_parameters(len(parameters)))
    change[:2, :2] = [[fx, 0.5 * fx], [fy, -0.5 * fy]]
    return change


def moved(
    placements: Placements, step: Float[np.ndarray, "m c"], pose: Float[np.ndarray, "m 6"]
) -> Placements:
    """Return the placements after a step of each view's camera, in the arrow's coordinates, and of its pose."""
    parameters = placements.parameters.copy()
    focal, ratio = np.clip(step[:, 0], -0.5, 0.5), np.clip(step[:, 1], -0.1, 0.1)
    parameters[:, 0] *= np.exp(focal + 0.5 * ratio)
    parameters[:, 1] *= np.exp(focal - 0.5 * ratio)
    parameters[:, 2 : step.shape[1]] += step[:, 2:]
    translations = placements.translations_mm + pose[:, 3:]
    # A centroid never passes through the camera.
    depth = placements.translations_mm[:, 2]
    translations[:, 2] = depth * np.exp(np.clip(pose[:, 5] / depth, -0.7, 0.7))
    return Placements(parameters, rotations_from_vectors(pose[:, :3]) @ placements.rotations, translations)
