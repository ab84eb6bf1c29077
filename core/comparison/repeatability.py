"""Repeatability by every method of the comparison, from the same images: the rows of Table III.

All rows are by the same rules, those of `core.metrology.repeatability`: RP_l and 3 S of ISO 9283:1998 (7.2.2), over all
images that a method has a pose for.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.comparison.results import Failure, MethodRow
from core.errors import InvalidArgument
from core.geometry import invert
from core.metrology import COMPONENTS, PerComponent, PoseCycles, PoseRepeatability, assess_repeatability

MIN_IMAGES = 2


@dataclass(frozen=True, slots=True)
class MethodPose:
    """One pose by one method; mm and rad.

    `images` are those that count, `failures` the others of the pose, with the reason of each. `noise_floor` is None
    where the method states no covariance; all figures are None below two images, for the reason in `failure`.
    """

    label: Hashable
    images: tuple[int, ...]
    repeatability: PerComponent[float | None]
    noise_floor: PerComponent[float | None] | None
    failures: tuple[Failure, ...]
    failure: Failure | None


@dataclass(frozen=True, slots=True)
class MethodRepeatability:
    """One method over all poses; `failure` is that of its row of calibrations."""

    method: str
    poses: tuple[MethodPose, ...]
    failure: Failure | None


def compare_repeatability(
    rows: Sequence[MethodRow], labels: Sequence[Hashable | None]
) -> tuple[MethodRepeatability, ...]:
    """Return every method's repeatability at every pose.

    `labels` are the poses that the images show, None for an image that belongs to none; poses are listed in the order
    in which they first occur.
    """
    images: dict[Hashable, list[int]] = {}
    for image, label in enumerate(labels):
        if label is not None:
            images.setdefault(label, []).append(image)
    return tuple(MethodRepeatability(row.method, tuple(_poses(row, images)), row.failure) for row in rows)


def _poses(row: MethodRow, images: dict[Hashable, list[int]]) -> list[MethodPose]:
    found = {image: invert(T) for image, T in row.poses.items()}
    failed = {failure.image: failure for failure in row.failures}
    together = failed.get(None)
    known = {label: [i for i in members if i in found] for label, members in images.items()}
    cycles: dict[Hashable, PoseCycles] = {}
    refused: dict[Hashable, Failure] = {}
    for label, members in known.items():
        if len(members) >= MIN_IMAGES:
            try:
                cycles[label] = _cycles(row, members, found)
            except InvalidArgument as error:
                refused[label] = Failure(None, error.code, error.detail, error.advice)
    assessed = dict(zip(cycles, assess_repeatability(list(cycles.values())), strict=True))
    poses = []
    for label, members in images.items():
        without = [failed[i] for i in members if i in failed]
        if label in assessed:
            poses.append(_assessed(row, label, known[label], assessed[label], without))
        else:
            poses.append(_unknown(label, members, known[label], without, together or refused.get(label)))
    return poses


def _cycles(row: MethodRow, members: list[int], found: dict[int, Float[np.ndarray, "4 4"]]) -> PoseCycles:
    T = np.array([found[i] for i in members])
    covariances = None if row.scatter is None else np.array([row.scatter[i] for i in members])
    return PoseCycles(T[:, :3, 3], T[:, :3, :3], covariances)


def _assessed(
    row: MethodRow, label: Hashable, members: list[int], figures: PoseRepeatability, without: list[Failure]
) -> MethodPose:
    return MethodPose(
        label,
        tuple(members),
        figures.repeatability,
        figures.noise_floor if row.scatter is not None else None,
        tuple(without),
        None,
    )


def _unknown(
    label: Hashable,
    members: list[int],
    known: list[int],
    without: list[Failure],
    reason: Failure | None,
) -> MethodPose:
    few = Failure(
        None,
        "too_few_images",
        f"Repeatability takes at least {MIN_IMAGES} images of a pose; of {len(members)} here, {len(known)} gave a "
        "pose by this method.",
        "Visit the pose again: the standard asks for 30 cycles."
        if len(members) < MIN_IMAGES
        else "See why the others failed.",
    )
    nothing: PerComponent[float | None] = PerComponent(*[None] * len(COMPONENTS))
    return MethodPose(label, tuple(known), nothing, None, tuple(without), reason or few)
