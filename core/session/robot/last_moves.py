"""From which side every joint came to a pose, by the order in which poses were measured.

The order is that of the times of their images, where all are known; else cycle by cycle, in each the poses in the order
of their names, as programs visit them. Poses without cycles are one cycle if each was visited once. A joint that did
not move keeps the direction of its last move. A path between two poses that turns back is not known; where it does,
directions are wrong, and their estimated effect is small.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from core.session.model import MeasuredPose, SessionData, natural

LEAST_MOVE = np.radians(0.01)
"""A joint that moves by less stays where its friction holds it."""


def last_moves(
    order: Int[np.ndarray, " k"], joint_angles: Float[np.ndarray, "n j"]
) -> Float[np.ndarray, "n j"] | None:
    """Return the sign of each joint's last move before each pose, 0 before its first; None without an order."""
    if not len(order):
        return None
    signs = np.zeros_like(joint_angles)
    last, at = np.zeros(joint_angles.shape[1]), joint_angles[order[0]]
    for place in order:
        move = joint_angles[place] - at
        last = np.where(np.abs(move) > LEAST_MOVE, np.sign(move), last)
        signs[place], at = last, joint_angles[place]
    return signs


def measuring_order(data: SessionData, poses: Sequence[MeasuredPose]) -> Int[np.ndarray, " k"]:
    """Return the places of the poses as they were measured; none where that is not known."""
    times = [data.taken_h.get(pose.measurement_id) for pose in poses]
    known = [time for time in times if time is not None]
    if len(known) == len(poses) and len(set(known)) > 1:
        return np.array(sorted(range(len(poses)), key=lambda i: (known[i], i)), dtype=np.intp)
    cycles = [pose.cycle for pose in poses if pose.cycle is not None]
    if len(cycles) < len(poses) and (cycles or len({pose.pose_id for pose in poses}) < len(poses)):
        return np.zeros(0, dtype=np.intp)
    by_cycles = sorted(range(len(poses)), key=lambda i: (poses[i].cycle or 0, natural(poses[i].pose_id), i))
    return np.array(by_cycles, dtype=np.intp)
