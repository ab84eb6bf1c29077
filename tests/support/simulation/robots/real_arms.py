"""Arms as they are built: gears that turn unevenly, joints that give way to weight, and poses measured of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from core.kinematics.dh import frames
from core.kinematics.pose_observations import PoseData
from core.simulation.arm import KR5_ARC_LIMITS, Arm, kr5_arc
from tests.support.simulation.simulated_poses import Repeatability, measure_poses

MASSES_KG = np.array([30.0, 20.0, 12.0, 5.0, 3.0, 2.0])
OFF_THE_LINE_MM = 40.0
COMPLIANCE_RAD_PER_NM = 6e-6
COMPLIANT = (1, 2)  # the joints that carry the arm
NOISE = Repeatability(0.03, math.radians(0.004))
_AMPLITUDES_DEG = np.array([0.012, 0.008, 0.005, 0.005, 0.005, 0.005])
_G = 9.81
_MM_PER_M = 1000.0


@dataclass(frozen=True, slots=True)
class Gears:
    """Harmonics k of each joint's angle, with their cosines and sines (rad)."""

    k: Int[np.ndarray, " h"]
    cosines: Float[np.ndarray, "j h"]
    sines: Float[np.ndarray, "j h"]

    @classmethod
    def drawn(cls, rng: np.random.Generator, joints: int) -> Gears:
        """Draw the first three harmonics, and three between 8 and 23."""
        k = np.concatenate([[1, 2, 3], rng.integers(8, 24, 3)])
        scale = np.radians(_AMPLITUDES_DEG) / math.sqrt(2.0)
        return cls(k, *(rng.normal(0.0, 1.0, (joints, len(k))) * scale for _ in range(2)))

    def at(self, joint_angles: Float[np.ndarray, "n j"]) -> Float[np.ndarray, "n j"]:
        """Return what each joint turns by beyond its angle."""
        phase = joint_angles[:, :, None] * self.k
        return np.asarray(np.sum(self.cosines * np.cos(phase) + self.sines * np.sin(phase), axis=2))


@dataclass(frozen=True, slots=True)
class Links:
    """The weights of the links, and where their centres of mass are: the share of the way from the frame in which the
    joint turns to the next one, and what they are off that line, in the frame that turns with the link (mm).
    `rad_per_nm` is what the joints that carry the arm give way, `up` the vertical in the base.
    """

    masses_kg: Float[np.ndarray, " j"]
    share: Float[np.ndarray, " j"]
    off_mm: Float[np.ndarray, "j 3"]
    rad_per_nm: float = COMPLIANCE_RAD_PER_NM
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Links:
        """Draw masses within a factor of e of the usual ones, anywhere in the middle half of the links."""
        count = len(MASSES_KG)
        return cls(
            MASSES_KG * np.exp(rng.uniform(-1.0, 1.0, count)),
            rng.uniform(0.25, 0.75, count),
            rng.normal(0.0, OFF_THE_LINE_MM, (count, 3)),
        )

    def sag(self, arm: Arm, joint_angles: Float[np.ndarray, "n j"]) -> Float[np.ndarray, "n j"]:
        """Return what joints turn by under the weight of the links beyond them."""
        T = frames(arm.chain, joint_angles)
        o, z = T[:, :, :3, 3], T[:, :, :3, 2]
        between = o[:, :-1] + self.share[:, None] * (o[:, 1:] - o[:, :-1])
        centres = between + np.einsum("njkl,jl->njk", T[:, 1:, :3, :3], self.off_mm)
        found = np.zeros_like(joint_angles)
        for joint in COMPLIANT:
            lever = centres[:, joint:] - o[:, joint, None]
            weight = -_G * np.array(self.up) * self.masses_kg[joint:, None]
            moment = np.cross(lever / _MM_PER_M, weight).sum(axis=1)
            found[:, joint] = self.rad_per_nm * np.sum(moment * z[:, joint], axis=1)
        return found


@dataclass(frozen=True, slots=True)
class RealArm:
    """An arm with its gears and links; none for a perfect robot, whose joints do not give way either."""

    arm: Arm
    gears: Gears | None
    links: Links | None

    def turned(self, joint_angles: Float[np.ndarray, "n j"]) -> Float[np.ndarray, "n j"]:
        """Return the angles that the joints attain where these are stated."""
        if self.gears is None or self.links is None:
            return joint_angles
        return np.asarray(joint_angles + self.gears.at(joint_angles) + self.links.sag(self.arm, joint_angles))


def real_arm(rng: np.random.Generator, *, perfect: bool = False) -> RealArm:
    """Draw a KR5 Arc as built."""
    arm = kr5_arc(rng)
    return (
        RealArm(arm, None, None)
        if perfect
        else RealArm(arm, Gears.drawn(rng, len(arm.chain)), Links.drawn(rng))
    )


def angles_within_limits(
    rng: np.random.Generator, count: int, share: float = 0.6
) -> Float[np.ndarray, "n 6"]:
    """Draw joint angles over the middle share of a KR5 Arc's limits."""
    low, high = KR5_ARC_LIMITS.T
    return np.asarray(0.5 * (low + high) + 0.5 * share * (high - low) * rng.uniform(-1.0, 1.0, (count, 6)))


def measured(real: RealArm, joint_angles: Float[np.ndarray, "n 6"], rng: np.random.Generator) -> PoseData:
    """Return the poses of an arm, with covariances of the instrument, at the angles that are stated."""
    attained = real.turned(joint_angles)
    return replace(
        measure_poses(real.arm, attained, rng, estimator="given", robot=NOISE), joint_angles=joint_angles
    )
