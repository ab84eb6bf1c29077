"""A witness: a pose revisited in every cycle, whose slow motion is that of mount, target and room, not of the robot's
return to a pose; it is reported, and subtracted from all poses on request.

The witness scatters as the robot does. So not its visits are subtracted, which would add their scatter, but the motion
that they show beyond it (`core.metrology.slow_motion`). Positions move; orientations stay as they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from core.errors import Advisory, WitnessUnusable
from core.metrology import SlowMotion, slow_motion
from core.session.model import MeasuredPose

MIN_CYCLES = 5
MAX_CYCLES = 2000


@dataclass(frozen=True, slots=True)
class Witness:
    """The pose that witnesses what moves, and whether its motion is subtracted."""

    pose_id: str
    subtract: bool = False


@dataclass(frozen=True, slots=True)
class WitnessMotion:
    """The slow motion of a witness over its cycles, mm, in the frame of its visits."""

    witness: Witness
    cycles: Int[np.ndarray, " n"]
    frame: int
    found: SlowMotion

    @property
    def moved(self) -> bool:
        """Whether its visits show a motion."""
        return bool(self.found.motion_mm.any())

    @property
    def shift_mm(self) -> Float[np.ndarray, "3"]:
        """From the first cycle to the last."""
        return np.asarray(self.found.motion_mm[-1] - self.found.motion_mm[0])

    def at(self, cycles: Int[np.ndarray, " m"]) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, " m"]]:
        """Return motion and its standard uncertainty at cycles, between those of the witness where it was not seen."""
        motion = [np.interp(cycles, self.cycles, axis) for axis in self.found.motion_mm.T]
        return np.array(motion).T, np.interp(cycles, self.cycles, self.found.standard_uncertainty_mm)


def witness_motion(visits: Mapping[str, Sequence[MeasuredPose]], witness: Witness) -> WitnessMotion:
    """Return how the witness moved.

    Raises WitnessUnusable for a pose without five numbered cycles that count, or with more than 2,000.
    """
    numbered: dict[int, list[MeasuredPose]] = {}
    for visit in visits.get(witness.pose_id, ()):
        if visit.cycle is not None:
            numbered.setdefault(visit.cycle, []).append(visit)
    if not MIN_CYCLES <= len(numbered) <= MAX_CYCLES:
        raise WitnessUnusable(
            f"The witness {witness.pose_id} has {len(numbered)} numbered cycles that count; a witness takes "
            f"{MIN_CYCLES} to {MAX_CYCLES}."
        )
    cycles = np.array(sorted(numbered), dtype=np.intp)
    positions = np.array([np.mean([v.position_mm for v in numbered[c]], axis=0) for c in cycles.tolist()])
    frame = numbered[int(cycles[0])][0].frame
    return WitnessMotion(witness, cycles, frame, slow_motion(cycles, positions))


def without_motion(
    visits: Mapping[str, Sequence[MeasuredPose]], motion: WitnessMotion
) -> dict[str, list[MeasuredPose]]:
    """Return the visits with the witness's motion subtracted from positions in its frame, its uncertainty added to the
    instrument's; visits without a cycle stay as they are.
    """
    found: dict[str, list[MeasuredPose]] = {}
    for pose_id, of_pose in visits.items():
        moved = []
        for visit in of_pose:
            if visit.cycle is None or visit.frame != motion.frame:
                moved.append(visit)
                continue
            by, u = motion.at(np.array([visit.cycle]))
            scatter = visit.scatter
            if scatter is not None:
                scatter = scatter + np.diag([float(u[0]) ** 2] * 3 + [0.0] * 3)
            moved.append(replace(visit, position_mm=visit.position_mm - by[0], scatter=scatter))
        found[pose_id] = moved
    return found


def witness_warnings(
    motion: WitnessMotion | None, visits: Mapping[str, Sequence[MeasuredPose]]
) -> list[Advisory]:
    """Say that the witness moved, or to which poses its motion says nothing."""
    if motion is None:
        return []
    warnings = []
    if motion.moved and not motion.witness.subtract:
        warnings.append(
            Advisory(
                "witness_moved",
                f"The witness {motion.witness.pose_id} moved by {np.linalg.norm(motion.shift_mm):.3g} mm from its "
                "first cycle to its last: mount, target or room moved, and that is in the figures of all poses.",
                "Fix what moved and measure again, or subtract the motion (`subtract_witness=true`).",
            )
        )
    elsewhere = sum(
        visit.cycle is None or visit.frame != motion.frame for of_pose in visits.values() for visit in of_pose
    )
    if motion.moved and motion.witness.subtract and elsewhere:
        warnings.append(
            Advisory(
                "witness_elsewhere",
                f"The witness's motion is not subtracted from {elsewhere} images without a cycle or of another target.",
                "Tag every image with its cycle, and take a witness before the same target.",
            )
        )
    return warnings
