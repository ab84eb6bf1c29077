"""Calibration of a session from its images: cameras and poses, the entry for scripts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from core.calibration import Lens
from core.errors import InvalidArgument, TooFewMeasurements
from core.geometry import Camera
from core.image import DEFAULT_MAX_PIXELS
from core.kinematics import Chain
from core.pipeline import TargetOutcome, calibrate_targets
from core.session.estimate import SessionEstimate
from core.session.estimation import estimate_session
from core.session.model import NO_TARGET, CommandedPose, ImageObservation, SessionData, group_views, natural
from core.session.robot import with_nominal_orientations
from core.targets import GridPoints, TargetSpec


@dataclass(frozen=True, slots=True)
class TaggedImage:
    """One image of a session and what is known of it.

    Parameters
    ----------
    data
        The whole PNG, JPEG, TIFF or BMP file.
    name
        Names the image in messages and answers; no other image of the session has it.
    pose_id
        The robot's pose, under any name.
    cycle
        The number of the visit to the pose.
    joint_angles_deg
        Of the robot, first joint first.
    focus_group
        Images with the same one share one setting of camera and lens.
    """

    data: bytes = field(repr=False)
    name: str
    pose_id: str
    cycle: int | None = None
    joint_angles_deg: Sequence[float] | None = None
    focus_group: str = "default"


@dataclass(frozen=True, slots=True)
class CalibratedSession:
    """A session and its estimate: what `assess_repeatability` and `identify_robot` take."""

    data: SessionData
    estimate: SessionEstimate


def calibrate_session(
    images: Sequence[TaggedImage],
    targets: TargetSpec | Sequence[TargetSpec],
    *,
    estimator: str = "pooled",
    commanded: Mapping[str, CommandedPose] | None = None,
    lens: Lens | None = None,
    intrinsics: Camera | None = None,
    nominal: Chain | None = None,
    max_pixels: int = DEFAULT_MAX_PIXELS,
) -> CalibratedSession:
    """Calibrate the camera of a session and determine its pose in every image.

    Parameters
    ----------
    images
        In any order; the answer does not depend on it.
    targets
        The targets that the images may show, one or several in one image.
    estimator
        `pooled` (one camera for all images of a focus group), `pooled_free_focal`, `per_image`,
        `per_image_session_prior` (each image by itself, with the lens of the others as its prior),
        `per_image_fixed_pp` or `given` (the camera is `intrinsics`).
    commanded
        What the robot was commanded, by `pose_id`, in its base frame: positions (mm), roll, pitch, yaw (deg).
    lens
        A 5 % prior on the focal length.
    nominal
        The robot as its maker describes it (mm, rad).

    Returns
    -------
    CalibratedSession
        `estimate.groups` has each focus group's camera with its covariance (px), `estimate.poses` the camera's pose in
        each image in its target's frame (mm; covariance in mm and rad), `estimate.excluded` by name why other images
        have none.

    Raises
    ------
    TooFewMeasurements
        There are no images.
    InvalidArgument
        Two images have one name.
    ImageError
        The bytes of one are no image that is read.
    SessionError, EstimationError
        No image can be estimated.
    """
    specs = (targets,) if isinstance(targets, TargetSpec) else tuple(targets)
    if not images:
        raise TooFewMeasurements("The session has no images.", "Give the images of the target.")
    counts = Counter(image.name for image in images)
    repeated = next((name for name, count in counts.items() if count > 1), None)
    if repeated is not None:
        raise InvalidArgument(
            f"{counts[repeated]} images have the name {repeated}.",
            "Give every image a name of its own, such as its path.",
        )
    ordered = sorted(images, key=lambda i: (natural(i.pose_id), i.cycle is None, i.cycle or 0, i.name))
    observations: list[ImageObservation] = []
    points: dict[int, GridPoints] = {}
    for image in ordered:
        outcomes = list(calibrate_targets(image.data, specs, lens=lens, max_pixels=max_pixels))
        shown = [k for k, outcome in enumerate(outcomes) if _grid_points(outcome) is not None]
        for k in shown or [0]:
            found, failure = _grid_points(outcomes[k]), outcomes[k].failure
            if found is not None:
                points[len(observations)] = found
            observations.append(
                ImageObservation(
                    image.name if len(shown) < 2 else f"{image.name}[{k}]",
                    image.pose_id,
                    image.cycle,
                    image.name,
                    k if found is not None else NO_TARGET,
                    image.focus_group,
                    image.joint_angles_deg,
                    found.image_width_px if found is not None else 0,
                    found.image_height_px if found is not None else 0,
                    failure.code if failure is not None else None,
                    failure.detail if failure is not None else None,
                    found.labelling if found is not None else "absolute",
                )
            )
    data = SessionData(
        specs,
        tuple(f"targets[{k}]" for k in range(len(specs))),
        tuple(observations),
        group_views(observations, points),
        commanded or {},
        lens=lens,
        intrinsics=intrinsics,
        nominal=nominal,
    )
    data = with_nominal_orientations(data)
    return CalibratedSession(data, estimate_session(data, estimator))


def _grid_points(outcome: TargetOutcome) -> GridPoints | None:
    """Return the points found of a target, of of a refused image too."""
    points: GridPoints | None = None
    if outcome.calibration is not None:
        points = outcome.calibration.points
    elif outcome.failure is not None:
        points = outcome.failure.points
    return points
