"""One reading for every board that looks the same when turned, over all images of a session."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from app.services.analyses.snapshot import Image, Snapshot
from core import Advisory, TargetSpec
from core.calibration.estimators import GroupEstimate
from core.calibration.readings import choose_readings, turns_alike
from core.transforms import rpy_to_rotation


@dataclass(frozen=True, slots=True)
class GroupPoses:
    """A focus group's estimate, and the images its arrays run over."""

    name: str
    images: tuple[Image, ...]
    estimate: GroupEstimate


def read_alike(snapshot: Snapshot, groups: Sequence[GroupPoses]) -> tuple[list[GroupPoses], list[Advisory]]:
    """Return the groups with their poses in the frames of one reading, and what to know of it."""
    remarks: list[Advisory] = []
    alike = list(groups)
    commanded: dict[Hashable, Float[np.ndarray, "3 3"]] = {
        pose_id: rpy_to_rotation(np.radians([c.roll_deg, c.pitch_deg, c.yaw_deg]))
        for pose_id, c in snapshot.commanded.items()
        if c.roll_deg is not None and c.pitch_deg is not None and c.yaw_deg is not None
    }
    place = {image.measurement_id: i for i, image in enumerate(snapshot.images)}
    for target, fields in enumerate(snapshot.targets):
        turns = turns_alike(TargetSpec(**fields))
        shown = sorted(
            (place[image.measurement_id], g, k)
            for g, group in enumerate(groups)
            for k, image in enumerate(group.images)
            if image.target == target
        )
        if len(turns) == 1 or not shown:
            continue
        poses = [snapshot.images[i].pose_id for i, _, _ in shown]
        rotations = np.array([groups[g].estimate.rotations[k] for _, g, k in shown])
        readings = choose_readings(rotations, poses, turns, commanded)
        of_group = np.array([g for _, g, _ in shown])
        rows = np.array([k for _, _, k in shown])
        for g, group in enumerate(alike):
            for turn in range(1, len(turns)):  # the first is none
                turned = rows[(of_group == g) & (readings.turns == turn)]
                if len(turned):
                    group = replace(group, estimate=_turned(group.estimate, turned, turns[turn]))
            alike[g] = group
        if not readings.by_commands and len(set(poses)) > 1:
            remarks.append(_ambiguous(readings.doubtful))
    return alike, remarks


def _ambiguous(doubtful: Sequence[Hashable]) -> Advisory:
    doubt = f" In doubt: {', '.join(str(pose) for pose in doubtful)}." if doubtful else ""
    return Advisory(
        "orientation_ambiguous",
        "The board looks the same when turned; it was read so that the camera turns least between poses. "
        f"Repeatability does not depend on it, positions of poses against one another do.{doubt}",
        "State the poses' commanded orientations, or use a board whose columns and rows have an odd sum.",
    )


def _turned(
    estimate: GroupEstimate, rows: Int[np.ndarray, " r"], turn: Float[np.ndarray, "4 4"]
) -> GroupEstimate:
    """Return the estimate with some images' target frame turned: T_target_camera becomes turn⁻¹ T_target_camera."""
    back = turn[:3, :3].T
    both = np.zeros((6, 6))
    both[:3, :3] = both[3:, 3:] = back
    positions, rotations = estimate.positions_mm.copy(), estimate.rotations.copy()
    covariance, scatter, common = estimate.covariance.copy(), estimate.scatter.copy(), estimate.common.copy()
    positions[rows] = (positions[rows] - turn[:3, 3]) @ back.T
    rotations[rows] = back @ rotations[rows]
    covariance[rows] = both @ covariance[rows] @ both.T
    scatter[rows] = both @ scatter[rows] @ both.T
    common[rows] = both @ common[rows]
    return replace(
        estimate,
        positions_mm=positions,
        rotations=rotations,
        covariance=covariance,
        scatter=scatter,
        common=common,
    )
