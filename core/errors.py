"""What can go wrong in the numerics, as one tree.

    GridposeError                        code, detail, advice; `points` where grid points were found before
    ├── InvalidInput                     the caller's arguments cannot be used
    │   ├── InvalidTarget                invalid_target
    │   └── InvalidArgument              invalid_argument
    ├── ImageError                       the bytes are no image we take
    │   ├── EmptyImage                   empty_upload
    │   ├── UnsupportedImage             unsupported_image
    │   ├── ImageTooManyPixels           image_too_many_pixels
    │   └── UndecodableImage             undecodable_image
    ├── DetectionError                   the image does not show the target asked for
    │   ├── TargetNotFound               target_not_found
    │   ├── TargetMismatch               target_mismatch
    │   ├── TargetAmbiguous              target_ambiguous
    │   ├── TargetMirrored               target_mirrored
    │   └── OriginUnknown                labelling_ambiguous
    ├── SessionError                     the session does not hold what an analysis of it needs
    │   ├── TooFewMeasurements           too_few_measurements
    │   ├── TooManyMeasurements          too_many_measurements
    │   ├── IntrinsicsMissing            intrinsics_missing
    │   ├── MixedImageSizes              mixed_image_sizes
    │   ├── NothingUsable                no_usable_images
    │   ├── TooFewCycles                 too_few_cycles
    │   ├── CommandedPosesMissing        commanded_poses_missing
    │   ├── MeasuredPosesMissing         measured_poses_missing
    │   ├── NominalRobotMissing          nominal_robot_missing
    │   ├── SeveralTargetsOnFlange       several_targets_on_flange
    │   ├── SweepJointUnknown            sweep_joint_unknown
    │   ├── SweepPoseUnknown             sweep_pose_unknown
    │   ├── WitnessUnusable              witness_unusable
    │   ├── NoViewShowsTarget            no_view_shows_target
    │   └── RobotBaseMismatch            robot_base_mismatch
    └── EstimationError                  the points or poses do not determine an answer
        ├── FocalNotObservable           focal_not_observable
        │   └── FocalWeaklyObservable    focal_weakly_observable
        ├── PoseAmbiguous                pose_ambiguous
        ├── DegenerateGeometry           degenerate_geometry
        ├── MotionInsufficient           motion_insufficient
        ├── TargetShapeNotObservable     target_shape_not_observable
        ├── NotConverged                 not_converged
        └── KinematicsError              joint angles and motions do not determine the robot's geometry
            ├── JointAnglesMissing       joint_angles_missing
            ├── JointAnglesInconsistent  joint_angles_inconsistent
            ├── JointAnglesUnitMismatch  joint_angles_unit_mismatch
            ├── LengthsUnitMismatch      lengths_unit_mismatch
            ├── FrameMirrored            frame_mirrored
            ├── JointNotExcited          joint_not_excited
            ├── TooFewPoses              too_few_poses
            ├── ArcTooShort              arc_too_short
            ├── RotationsMissing         rotations_required
            └── PrismaticJoint           prismatic_joint

`code` is stable and snake_case, `detail` says what happened with its figures, `advice` says what to do next.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar


@dataclass(frozen=True, slots=True)
class Advisory:
    """A warning that accompanies a result: a stable code, what was observed, and what to do about it."""

    code: str
    detail: str
    advice: str | None = None


ADVISED_TILT = "30° to 45°"
"""Of a flat target against the image plane: of views at 20° about half determine the focal length (docs/limits.md)."""
MAX_LISTED = 5  # labels in a message; of more it gives the number of the others


def listed(labels: Iterable[str]) -> str:
    """Return labels for a message: "P1, P2, P3, P4, P5 and 7 more"."""
    several = list(labels)
    more = f" and {len(several) - MAX_LISTED} more" if len(several) > MAX_LISTED else ""
    return ", ".join(several[:MAX_LISTED]) + more


class GridposeError(Exception):
    """Base of every failure the numerics raise on purpose."""

    code: ClassVar[str] = "gridpose_error"
    default_advice: ClassVar[str | None] = None

    def __init__(self, detail: str, advice: str | None = None, *, points: Any = None) -> None:
        super().__init__(detail)
        self.detail = detail
        self.advice = advice if advice is not None else self.default_advice
        self.points = points
        """The `core.targets.GridPoints` found before the failure, or None: they still serve pooled estimates."""


class InvalidInput(GridposeError):
    code = "invalid_input"
    default_advice = "Correct the value named and try again."


class InvalidTarget(InvalidInput):
    code = "invalid_target"

    def __init__(self, detail: str, advice: str | None = None, *, field: str | None = None) -> None:
        super().__init__(detail, advice)
        self.field = field
        """The field of `core.targets.TargetSpec` that is to be corrected, where it is one."""


class InvalidArgument(InvalidInput):
    code = "invalid_argument"


class ImageError(GridposeError):
    code = "image_error"


class EmptyImage(ImageError):
    code = "empty_upload"
    default_advice = "Send the image file's bytes as the body."


class UnsupportedImage(ImageError):
    code = "unsupported_image"
    default_advice = "Send PNG, JPEG, TIFF or BMP with 8 or 16 bit, grey or colour."


class ImageTooManyPixels(ImageError):
    code = "image_too_many_pixels"
    default_advice = (
        "Bin the image or scale it down, or raise GRIDPOSE_MAX_IMAGE_PIXELS. Do not crop it: the lens's middle would "
        "no longer be the image's."
    )


class UndecodableImage(ImageError):
    code = "undecodable_image"
    default_advice = "The file is damaged or cut short; save it again and upload that."


class DetectionError(GridposeError):
    code = "detection_error"


class TargetNotFound(DetectionError):
    code = "target_not_found"
    default_advice = "Show the whole grid, sharp and evenly lit, and check the target's size."


class TargetMismatch(DetectionError):
    code = "target_mismatch"
    default_advice = "Check columns and rows, which count inner corners; keep other grids out of view."


class TargetAmbiguous(DetectionError):
    code = "target_ambiguous"
    default_advice = "Name the target (target_id), or use targets that differ in size or dictionary."


class TargetMirrored(DetectionError):
    code = "target_mirrored"
    default_advice = "Print without mirroring, and switch the camera's image mirroring off."


class OriginUnknown(DetectionError):
    code = "labelling_ambiguous"
    default_advice = "Show the whole board, or use ChArUco, an AprilGrid, or a chessboard with dots."


class SessionError(GridposeError):
    code = "session_error"


class TooFewMeasurements(SessionError):
    code = "too_few_measurements"
    default_advice = "Upload images of the target first."


class TooManyMeasurements(SessionError):
    code = "too_many_measurements"
    default_advice = "Divide the images among several sessions."


class IntrinsicsMissing(SessionError):
    code = "intrinsics_missing"
    default_advice = "PATCH the session with intrinsics, or choose another estimator."


class MixedImageSizes(SessionError):
    code = "mixed_image_sizes"
    default_advice = "Give each camera setting a focus_group of its own: `gridpose measurements correct`."


class NothingUsable(SessionError):
    code = "no_usable_images"
    default_advice = "Look at failures and overlays; show the whole grid, sharp, evenly lit, tilted."


class TooFewCycles(SessionError):
    code = "too_few_cycles"
    default_advice = (
        "Visit poses again and state each visit's cycle; mend tags with `gridpose measurements correct`."
    )


class CommandedPosesMissing(SessionError):
    code = "commanded_poses_missing"
    default_advice = (
        "State position_mm, roll_deg, pitch_deg and yaw_deg (POST .../poses, or `gridpose poses load`)."
    )


class MeasuredPosesMissing(SessionError):
    code = "measured_poses_missing"
    default_advice = "Send them (`gridpose measured-poses import`), or omit source to use images."


class NominalRobotMissing(SessionError):
    code = "nominal_robot_missing"
    default_advice = (
        "Make a robot with its Denavit-Hartenberg parameters (`gridpose robots create`), and give the session its "
        "robot_id (PATCH, `gridpose sessions change --robot`)."
    )


class SeveralTargetsOnFlange(SessionError):
    code = "several_targets_on_flange"
    default_advice = (
        "Leave one target in the session's target_ids and give each other one a session of its own; or set the "
        "session's camera_mount to robot if the camera is on the robot."
    )


class SweepJointUnknown(SessionError):
    code = "sweep_joint_unknown"
    default_advice = "Name a joint by its number, counted from 1 at the base."


class SweepPoseUnknown(SessionError):
    code = "sweep_pose_unknown"
    default_advice = "Name poses by their pose_id; * stands for any text, ? for one character."


class WitnessUnusable(SessionError):
    code = "witness_unusable"
    default_advice = "Name a pose that was visited in every cycle, and tag its images with their cycles."


class NoViewShowsTarget(SessionError):
    code = "no_view_shows_target"


class RobotBaseMismatch(SessionError):
    code = "robot_base_mismatch"


class EstimationError(GridposeError):
    code = "estimation_error"


class FocalNotObservable(EstimationError):
    code = "focal_not_observable"
    default_advice = (
        f"Tilt the target by {ADVISED_TILT}, or state the session's lens (focal length and pixel pitch) or its "
        "intrinsics (`lens`, `intrinsics`: PATCH /v1/sessions/{session_id}, `gridpose sessions change --file`)."
    )


class FocalWeaklyObservable(FocalNotObservable):
    code = "focal_weakly_observable"
    default_advice = f"Use the estimator pooled, or tilt the target by {ADVISED_TILT}."


class PoseAmbiguous(EstimationError):
    code = "pose_ambiguous"
    default_advice = (
        f"Fill more of the image (nearer, or a larger board), and tilt the target by {ADVISED_TILT}."
    )


class DegenerateGeometry(EstimationError):
    code = "degenerate_geometry"
    default_advice = "Use an image that shows the grid's points spread over two directions."


class MotionInsufficient(EstimationError):
    code = "motion_insufficient"
    default_advice = "Add poses whose orientations differ by 20° or more about at least two different axes."


class TargetShapeNotObservable(EstimationError):
    code = "target_shape_not_observable"
    default_advice = "Add images with the target tilted by 20° to 40° to all sides, and turned in its plane."


class NotConverged(EstimationError):
    code = "not_converged"
    default_advice = "Check the target's size and the image's sharpness, and take the image again."


class KinematicsError(EstimationError):
    code = "kinematics_error"
    default_advice = "Check the joint angles that the poses carry."


class JointAnglesMissing(KinematicsError):
    code = "joint_angles_missing"
    default_advice = "Send joint_angles_deg with every pose or image, or exclude the images that have none."


class JointAnglesInconsistent(KinematicsError):
    code = "joint_angles_inconsistent"
    default_advice = "Give every pose one angle for each of the robot's joints, in their order from the base."


class JointAnglesUnitMismatch(KinematicsError):
    code = "joint_angles_unit_mismatch"
    default_advice = "The angles look like radians: send them in degrees."


class LengthsUnitMismatch(KinematicsError):
    code = "lengths_unit_mismatch"
    default_advice = "Give positions and the robot's lengths in millimetres."


class FrameMirrored(KinematicsError):
    code = "frame_mirrored"
    default_advice = (
        "Export the positions in a right-handed frame: two of its axes are exchanged, or one counts backwards. Check "
        "the columns of the import, too."
    )


class JointNotExcited(KinematicsError):
    code = "joint_not_excited"
    default_advice = (
        "Add a sweep of this joint: poses at which it alone moves and the others rest. If the joint slides and rests "
        "at one travel, describe the robot without it (its travel counts in d_mm of a neighbour about the same axis), "
        "and send the angles of the other joints alone."
    )


class TooFewPoses(KinematicsError):
    code = "too_few_poses"
    default_advice = "Add poses at other joint angles; thirty that move all joints are a sound beginning."


class ArcTooShort(KinematicsError):
    code = "arc_too_short"
    default_advice = "Sweep this joint over 80° or more, or use the combined method, which needs less."


class RotationsMissing(KinematicsError):
    code = "rotations_required"
    default_advice = "The poses are positions alone: use the circle method (cpa), or measure rotations too."


class PrismaticJoint(KinematicsError):
    code = "prismatic_joint"
    default_advice = (
        "Only turning joints are identified. If the joint slides, keep it at one travel in all poses, describe the "
        "robot without it (its travel counts in d_mm of a neighbour about the same axis), and send the angles of the "
        "other joints alone. If it turns, check which joint each angle is of."
    )
