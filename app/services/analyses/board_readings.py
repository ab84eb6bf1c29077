"""One reading for every board that looks the same when turned, over all images of a session."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from app.services.analyses.naming import origin_of
from app.services.analyses.snapshot import Image, Snapshot, natural
from core import Advisory, TargetSpec
from core.calibration.estimators import GroupEstimate
from core.calibration.readings import choose_readings, turns_alike
from core.transforms import rpy_to_rotation

NAMED = 5
SAME_DEG = 1.0
"""Joint angles of an image that differ by less from the pose's are those of the pose."""


@dataclass(frozen=True, slots=True)
class GroupPoses:
    """A focus group's estimate, and the images its arrays run over."""

    name: str
    images: tuple[Image, ...]
    estimate: GroupEstimate


@dataclass(frozen=True, slots=True)
class ReadAlike:
    """The groups with their poses in the frames of one reading; the images, by measurement, that no reading brings
    near the others of their pose; what to know of it all.
    """

    groups: list[GroupPoses]
    unclear: frozenset[str]
    remarks: list[Advisory]


def read_alike(snapshot: Snapshot, groups: Sequence[GroupPoses]) -> ReadAlike:
    """Choose one reading for every target over all images of it, where images that show its origin leave it open."""
    alike = list(groups)
    doubtful: set[str] = set()
    contradicting: set[str] = set()
    unclear: set[str] = set()
    guessed = False
    commanded = _commanded_rotations(snapshot)
    place = {image.measurement_id: i for i, image in enumerate(snapshot.images)}
    for target, fields in enumerate(snapshot.targets):
        spec = TargetSpec(**fields)
        turns = turns_alike(spec)
        shown = sorted(
            (place[image.measurement_id], g, k)
            for g, group in enumerate(groups)
            for k, image in enumerate(group.images)
            if image.target == target
        )
        if not shown or (len(turns) == 1 and not commanded):
            continue
        images = [snapshot.images[i] for i, _, _ in shown]
        labels = [_label(image, snapshot) for image in images]
        rotations = np.array([groups[g].estimate.rotations[k] for _, g, k in shown])
        known = [origin_of(image, spec) == "known" for image in images]
        readings = choose_readings(rotations, labels, turns, commanded, known)
        of_group = np.array([g for _, g, _ in shown])
        rows = np.array([k for _, _, k in shown])
        for g, group in enumerate(alike):
            for turn in range(1, len(turns)):  # the first is none
                turned = rows[(of_group == g) & (readings.turns == turn)]
                if len(turned):
                    group = replace(group, estimate=_turned(group.estimate, turned, turns[turn]))
            alike[g] = group
        unclear |= {
            image.measurement_id for image, one in zip(images, readings.unclear.tolist(), strict=True) if one
        }
        contradicting |= {_pose_id(label) for label in readings.contradicting}
        if not (readings.settled or all(known)) and len(set(labels)) > 1:
            guessed = True
            doubtful |= {_pose_id(label) for label in readings.doubtful}
    remarks = [_ambiguous(sorted(doubtful, key=natural))] if guessed else []
    if unclear:
        remarks.append(_unclear([snapshot.images[place[one]].pose_id for one in unclear]))
    if contradicting:
        remarks.append(_contradicting(contradicting))
    return ReadAlike(alike, frozenset(unclear), remarks)


def _commanded_rotations(snapshot: Snapshot) -> dict[Hashable, Float[np.ndarray, "3 3"]]:
    return {
        pose_id: rpy_to_rotation(np.radians([c.roll_deg, c.pitch_deg, c.yaw_deg]))
        for pose_id, c in snapshot.commanded.items()
        if c.roll_deg is not None and c.pitch_deg is not None and c.yaw_deg is not None
    }


def _label(image: Image, snapshot: Snapshot) -> Hashable:
    """Return what images of one orientation have in common: the pose; with joint angles of their own, which override
    the pose's, these too, unless they are what the pose was told.
    """
    own, told = image.joint_angles_deg, snapshot.commanded.get(image.pose_id)
    if own is None:
        return image.pose_id
    if told is not None and told.roll_deg is not None:
        joints = told.joint_angles_deg
        if joints is None or (
            len(joints) == len(own) and max(abs(a - b) for a, b in zip(own, joints, strict=True)) < SAME_DEG
        ):
            return image.pose_id
    return (image.pose_id, *(round(angle) for angle in own))


def _pose_id(label: Hashable) -> str:
    return str(label[0]) if isinstance(label, tuple) else str(label)


def _listed(pose_ids: Iterable[str]) -> str:
    named = sorted(set(pose_ids), key=natural)
    more = f" and {len(named) - NAMED} more" if len(named) > NAMED else ""
    return f"{', '.join(named[:NAMED])}{more}"


def _ambiguous(doubtful: Sequence[str]) -> Advisory:
    doubt = f" In doubt: {_listed(doubtful)}." if doubtful else ""
    return Advisory(
        "orientation_ambiguous",
        "The board looks the same when turned; it was read so that the camera turns least between poses. "
        f"Repeatability does not depend on it, positions of poses against one another do.{doubt}",
        "State the poses' commanded orientations, or use a board whose columns and rows have an odd sum, a ChArUco "
        "board, or marked squares.",
    )


def _unclear(pose_ids: Sequence[str]) -> Advisory:
    return Advisory(
        "orientation_unclear",
        f"{len(pose_ids)} images of a board that looks the same when turned show another orientation than the first of "
        f"their pose, whichever way they are read, and no figure of a pose holds them: {_listed(pose_ids)}.",
        "Check that the images carry the tag of the pose they were taken at.",
    )


def _contradicting(pose_ids: Iterable[str]) -> Advisory:
    return Advisory(
        "pose_contradicts_command",
        f"The orientations commanded and those seen do not go together, whichever way the board is read: "
        f"{_listed(pose_ids)}.",
        "Check these poses' roll_deg, pitch_deg and yaw_deg (R = Rz(yaw) Ry(pitch) Rx(roll)) or joint angles, and that "
        "their images carry the right tag.",
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
