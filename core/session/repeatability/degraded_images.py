"""Cycles that do not count because their image is degraded: evidence about the instrument, not about the robot.

ISO 9283 rejects no cycle; repeatability is over all that the instrument measured properly. A distance from the others
is the robot's and never a reason. A cycle is excluded only where three things hold:

- its image has noise that the session's other images do not have (`GroupEstimate.image_p_values`);
- that noise matters: the covariance of its pose exceeds a share of the pose's scatter;
- that noise explains where it lies: its deviation is within what twice its covariance and the scatter allow. A slip of
  the robot in a noisy image counts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import chdtri

from core.errors import Advisory, listed
from core.session.estimate import ExcludedMeasurement, SessionEstimate
from core.session.model import MeasuredPose

FALSE_ALARMS = 1e-3
"""Chance that a session without degraded images has one named."""
MIN_SHARE = 0.25
"""Of the pose's scatter: a smaller covariance does not matter."""
WITHIN = 1e-3
"""Chance of a deviation farther than what the image's noise explains."""
MIN_LEFT = 5
_MAD_TO_DEVIATION = 1.4826


def degraded_images(estimate: SessionEstimate) -> dict[str, str]:
    """Return the images whose noise the others do not have, by measurement, with the evidence in words."""
    p_values = {
        pose.measurement_id: p
        for group in estimate.groups
        for pose, p in zip(group.poses, group.estimate.image_p_values.tolist(), strict=True)
    }
    limit = FALSE_ALARMS / (4.0 * max(len(p_values), 1))
    found = {}
    for measurement_id, (fine, pattern) in p_values.items():
        if min(fine, pattern) < limit:
            kind = "point by point" if fine <= pattern else "in a smooth pattern"
            found[measurement_id] = (
                f"The residuals of this image deviate {kind} from those of the other images of its pose as noise would "
                f"in one of {_odds(min(fine, pattern))} images"
            )
    return found


def exclude_degraded(
    visits: Sequence[MeasuredPose], degraded: Mapping[str, str]
) -> tuple[list[MeasuredPose], list[ExcludedMeasurement]]:
    """Return the visits to a pose that count, and those that do not with the evidence."""
    suspect = np.array([visit.measurement_id in degraded for visit in visits], dtype=np.bool_)
    if not suspect.any() or int(np.sum(~suspect)) < MIN_LEFT:
        return list(visits), []
    positions = np.array([visit.position_mm for visit in visits])
    middle = np.median(positions[~suspect], axis=0)
    scatter = _robust_scatter(positions, middle, ~suspect)
    counted, excluded = [], []
    for visit, position, named in zip(visits, positions, suspect.tolist(), strict=True):
        if named and visit.scatter is not None:
            own = visit.scatter[:3, :3]
            off = position - middle
            share = float(np.trace(own) / np.trace(scatter))
            distance = float(off @ np.linalg.solve(2.0 * own + scatter, off))
            if share > MIN_SHARE and distance <= float(chdtri(3.0, WITHIN)):
                detail = (
                    f"{degraded[visit.measurement_id]}; its own standard deviation is {np.sqrt(share):.1f} times the "
                    f"scatter of the pose, and explains its distance of {np.linalg.norm(off):.3g} mm from the median."
                )
                excluded.append(ExcludedMeasurement(visit.measurement_id, "image_degraded", detail))
                continue
        counted.append(visit)
    return counted, excluded


def degraded_warning(excluded: Mapping[str, Sequence[str]]) -> list[Advisory]:
    """Name the cycles that do not count, pose by pose."""
    if not excluded:
        return []
    named = "; ".join(f"{pose_id}: {listed(ids)}" for pose_id, ids in excluded.items())
    return [
        Advisory(
            "images_degraded",
            f"Cycles do not count because their images are degraded ({named}). A slip of the robot in such an image "
            "cannot be excluded; including_degraded has the figures with them.",
            "Look at these images, remove the cause (glare, vibration, something before the board), and repeat the "
            "cycles.",
        )
    ]


def _robust_scatter(
    positions: Float[np.ndarray, "n 3"], middle: Float[np.ndarray, "3"], sound: Bool[np.ndarray, " n"]
) -> Float[np.ndarray, "3 3"]:
    """Return the covariance of the sound cycles by their median deviations along its own axes, mm²."""
    off = positions[sound] - middle
    _, axes = np.linalg.eigh(off.T @ off)
    deviation = _MAD_TO_DEVIATION * np.median(np.abs(off @ axes), axis=0)
    return np.asarray((axes * np.maximum(deviation, 1e-9) ** 2) @ axes.T)


def _odds(p: float) -> str:
    return "more than a billion" if p < 1e-9 else f"{1.0 / p:.0e}"
