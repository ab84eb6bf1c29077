"""Bursts: several images of one stop of the robot, which are one visit to its pose and show the instrument's noise.

The robot did not move between the images of a stop (`core.session.visits`): their scatter is the instrument's alone,
whatever its noise is like.

Where the images of stops scatter significantly more than the model of the noise says, what they scatter beyond it at
a pose is added to the model's covariances there, for positions and orientations apart. Where they scatter less, the
model stands: what differs between stops but not within one (slow air, temperature) is in its repeats and in no burst.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.special import chdtrc

from core.errors import Advisory
from core.geometry import rotation_mean, rotation_vectors
from core.metrology import PerComponent, PoseCycles, assess_repeatability
from core.session.model import MeasuredPose
from core.session.visits import images_of, positions_of, rotations_of, stack_all

SIGNIFICANT = 0.01
"""Chance that images of a stop scatter so much more than the model says, were it right."""
MIN_DEGREES_OF_FREEDOM = 5
"""Of the images of one pose within their stops, below which their scatter is no floor."""


@dataclass(frozen=True, slots=True)
class BurstFloor:
    """What the images within one pose's stops scatter.

    `stops` were seen in several images, `images` in all; `degrees_of_freedom` is their difference. `noise_floor` is
    what a motionless robot would read by that scatter, mm and rad; None below `MIN_DEGREES_OF_FREEDOM`. `excess` is
    the positive part of an image's covariance within stops less the model's, positions and orientations apart.
    """

    stops: int
    images: int
    degrees_of_freedom: int
    noise_floor: PerComponent[float | None] | None
    excess: Float[np.ndarray, "6 6"]


@dataclass(frozen=True, slots=True)
class BurstNoise:
    """Scatter within all stops of a session over what the model of the noise says, as standard deviations.

    `p_values` are of a scatter so large under the model; of positions first, then of orientations.
    """

    stops: int
    images: int
    ratios: tuple[float, float]
    p_values: tuple[float, float]
    poses: Mapping[str, BurstFloor]

    @property
    def above_model(self) -> tuple[bool, bool]:
        """Whether the scatter within stops is significantly above the model's, and its excess is added."""
        return self.p_values[0] <= SIGNIFICANT, self.p_values[1] <= SIGNIFICANT


def burst_noise(visits: Mapping[str, Sequence[MeasuredPose]]) -> BurstNoise | None:
    """Return what the images within stops scatter, from merged visits by pose; None without a burst of two images.

    The scatter of Σ ‖d‖² over Σ (b - 1) tr M of stops of b images and modelled covariance M is χ²_ν / ν, by
    Welch-Satterthwaite ν = (Σ (b - 1) tr M)² / Σ (b - 1) tr M².
    """
    found: dict[str, BurstFloor] = {}
    squares, expected, spread = np.zeros(2), np.zeros(2), np.zeros(2)
    for pose_id, of_pose in visits.items():
        bursts = [visit.burst for visit in of_pose if len(visit.burst) > 1]
        if not bursts:
            continue
        deviations = [_deviations(images) for images in bursts]
        freedom = sum(len(images) - 1 for images in bursts)
        within = sum(d.T @ d for d in deviations) / freedom
        for images, d in zip(bursts, deviations, strict=True):
            modelled = stack_all(one.scatter for one in images)
            if modelled is None:
                continue
            mean = np.mean(modelled, axis=0)
            for k, axes in enumerate((slice(0, 3), slice(3, 6))):
                block = mean[axes, axes]
                squares[k] += float(np.sum(d[:, axes] ** 2))
                expected[k] += (len(images) - 1) * float(np.trace(block))
                spread[k] += (len(images) - 1) * float(np.sum(block * block))
        floor = _floor(of_pose, within) if freedom >= MIN_DEGREES_OF_FREEDOM else None
        excess = _excess(within, [one for images in bursts for one in images])
        found[pose_id] = BurstFloor(len(bursts), sum(map(len, bursts)), freedom, floor, excess)
    if not found:
        return None
    ratios, p_values = [1.0, 1.0], [1.0, 1.0]
    for k in range(2):
        if expected[k] > 0.0:
            freedom_of_sum = expected[k] ** 2 / spread[k]
            ratios[k] = math.sqrt(squares[k] / expected[k])
            p_values[k] = float(chdtrc(freedom_of_sum, freedom_of_sum * squares[k] / expected[k]))
    return BurstNoise(
        sum(one.stops for one in found.values()),
        sum(one.images for one in found.values()),
        (ratios[0], ratios[1]),
        (p_values[0], p_values[1]),
        found,
    )


def with_burst_noise(
    visits: Mapping[str, Sequence[MeasuredPose]], noise: BurstNoise | None
) -> dict[str, list[MeasuredPose]]:
    """Return the visits with what images scatter within stops beyond the model added to their covariances.

    A pose whose stops show little or nothing of it has the mean excess of the others.
    """
    if noise is None or not any(noise.above_model):
        return {pose_id: list(of_pose) for pose_id, of_pose in visits.items()}
    mask = np.repeat(noise.above_model, 3).astype(np.float64)
    known = {
        pose_id: one.excess
        for pose_id, one in noise.poses.items()
        if one.degrees_of_freedom >= MIN_DEGREES_OF_FREEDOM
    }
    usual: Float[np.ndarray, "6 6"] = np.mean([one.excess for one in noise.poses.values()], axis=0)
    found = {}
    for pose_id, of_pose in visits.items():
        excess = known.get(pose_id, usual) * np.outer(mask, mask)
        found[pose_id] = [
            visit
            if visit.scatter is None
            else replace(visit, scatter=visit.scatter + excess / len(images_of(visit)))
            for visit in of_pose
        ]
    return found


def burst_warnings(noise: BurstNoise | None) -> list[Advisory]:
    """Say that the images within stops scatter more than the model says."""
    if noise is None or not any(noise.above_model):
        return []
    larger = " and ".join(
        f"{ratio:.2g} times in {name}"
        for name, ratio, above in zip(
            ("position", "orientation"), noise.ratios, noise.above_model, strict=True
        )
        if above
    )
    return [
        Advisory(
            "burst_scatter_above_model",
            f"The {noise.images} images of {noise.stops} stops scatter more within their stops than the noise of their "
            f"points explains, {larger}; that scatter is counted as the instrument's.",
            "Let the robot settle longer before the first image, fix camera and target, and look for vibration and for "
            "warm air before the lens.",
        )
    ]


def _deviations(images: Sequence[MeasuredPose]) -> Float[np.ndarray, "b 6"]:
    """Return positions and rotation vectors about their mean; zero orientation where it is not known."""
    about = np.zeros((len(images), 6))
    positions = positions_of(images)
    about[:, :3] = positions - positions.mean(axis=0)
    rotations = rotations_of(images)
    if rotations is not None:
        about[:, 3:] = rotation_vectors(rotations, rotation_mean(rotations))
    return about


def _excess(within: Float[np.ndarray, "6 6"], images: Sequence[MeasuredPose]) -> Float[np.ndarray, "6 6"]:
    """Return the positive part of `within` less the images' mean covariance; zero where the model states none."""
    modelled = stack_all(one.scatter for one in images)
    found = np.zeros((6, 6))
    if modelled is not None:
        left = within - np.mean(modelled, axis=0)
        for axes in (slice(0, 3), slice(3, 6)):
            values, vectors = np.linalg.eigh(left[axes, axes])
            found[axes, axes] = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return found


def _floor(
    visits: Sequence[MeasuredPose], within: Float[np.ndarray, "6 6"]
) -> PerComponent[float | None] | None:
    """Return what these visits of a motionless robot would read if each image scattered as `within`."""
    if len(visits) < 2:
        return None
    cycles = PoseCycles(
        positions_of(visits),
        rotations_of(visits),
        np.array([within / len(images_of(visit)) for visit in visits]),
    )
    return assess_repeatability([cycles])[0].noise_floor
