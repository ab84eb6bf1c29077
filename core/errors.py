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
    ├── DetectionError                   the picture does not show what was asked for
    │   ├── TargetNotFound               target_not_found
    │   ├── TargetMismatch               target_mismatch
    │   ├── TargetAmbiguous              target_ambiguous
    │   └── TargetMirrored               target_mirrored
    └── EstimationError                  the points or poses do not determine an answer
        ├── OriginUnknown                origin_unknown
        ├── FocalNotObservable           focal_not_observable
        ├── PoseAmbiguous                pose_ambiguous
        ├── DegenerateGeometry           degenerate_geometry
        ├── MotionInsufficient           motion_insufficient
        ├── TargetShapeNotObservable     target_shape_not_observable
        ├── NotConverged                 not_converged
        └── KinematicsError              the joints' angles and motions do not tell the robot's geometry
            ├── JointAnglesMissing       joint_angles_missing
            ├── JointAnglesInconsistent  joint_angles_inconsistent
            ├── JointAnglesUnit          joint_angles_unit
            ├── JointNotMoved            joint_not_moved
            ├── TooFewPoses              too_few_poses
            ├── ArcTooShort              arc_too_short
            ├── RotationsMissing         rotations_missing
            └── PrismaticJoint           prismatic_joint

`code` is stable and snake_case, `detail` says what happened with its figures, `advice` says what to do next.
Nothing here knows of HTTP; the service maps classes to statuses in one table.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar


@dataclass(frozen=True, slots=True)
class Advisory:
    """A remark that travels with a result: a stable code, what was seen, and what to do about it."""

    code: str
    detail: str
    advice: str | None = None


class GridposeError(Exception):
    """Base of every failure the numerics raise on purpose."""

    code: ClassVar[str] = "gridpose_error"
    default_advice: ClassVar[str | None] = None

    def __init__(self, detail: str, advice: str | None = None, *, points: Any = None) -> None:
        super().__init__(detail)
        self.detail = detail
        self.advice = advice if advice is not None else self.default_advice
        self.points = points
        """The `core.targets.GridPoints` found before the failure, or None: a refused view still serves
        pooled estimates."""


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
    default_advice = "Crop or bin the image, or raise GRIDPOSE_MAX_IMAGE_PIXELS."


class UndecodableImage(ImageError):
    code = "undecodable_image"
    default_advice = "The file is damaged or cut short; save it again and upload that."


class DetectionError(GridposeError):
    code = "detection_error"


class TargetNotFound(DetectionError):
    code = "target_not_found"
    default_advice = (
        "Check that the whole grid is in view, sharp and evenly lit, and that the target's size is right."
    )


class TargetMismatch(DetectionError):
    code = "target_mismatch"
    default_advice = (
        "Check the target's columns and rows, which count inner corners, and keep other grids out of view."
    )


class TargetAmbiguous(DetectionError):
    code = "target_ambiguous"
    default_advice = (
        "Say which target the image shows (target_id), or use targets that differ in their numbers of points or in "
        "their markers' dictionaries."
    )


class TargetMirrored(DetectionError):
    code = "target_mirrored"
    default_advice = (
        "Print the target without mirroring, and switch the camera's or the software's image mirroring off."
    )


class EstimationError(GridposeError):
    code = "estimation_error"


class OriginUnknown(EstimationError):
    code = "origin_unknown"
    default_advice = (
        "Show the whole board, or use one whose origin can be told from a part: ChArUco, AprilGrid, or a chessboard "
        "with marked squares."
    )


class FocalNotObservable(EstimationError):
    code = "focal_not_observable"
    default_advice = "Tilt the target by 15° or more, or give a focal prior or session intrinsics."


class PoseAmbiguous(EstimationError):
    code = "pose_ambiguous"
    default_advice = (
        "Bring the camera nearer or use a larger board, so that it fills more of the image, and tilt it by 30° to "
        "45°."
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
    default_advice = "Send joint_angles_deg with every pose or image; or leave poses without them out."


class JointAnglesInconsistent(KinematicsError):
    code = "joint_angles_inconsistent"
    default_advice = "Give every pose one angle for each of the robot's joints, in their order from the base."


class JointAnglesUnit(KinematicsError):
    code = "joint_angles_unit"
    default_advice = "The angles look like radians: send them in degrees."


class JointNotMoved(KinematicsError):
    code = "joint_not_moved"
    default_advice = "Add a sweep of this joint: poses at which it alone moves and the others rest."


class TooFewPoses(KinematicsError):
    code = "too_few_poses"
    default_advice = "Add poses at other joint angles; thirty that move all joints are a sound beginning."


class ArcTooShort(KinematicsError):
    code = "arc_too_short"
    default_advice = (
        "Sweep this joint over a longer arc, 80° or more; or use the combined method, which needs less."
    )


class RotationsMissing(KinematicsError):
    code = "rotations_missing"
    default_advice = "The poses are positions alone: use the circle method (cpa), or measure rotations too."


class PrismaticJoint(KinematicsError):
    code = "prismatic_joint"
    default_advice = (
        "Only turning joints are identified: leave this joint's poses out and describe the rest as the robot."
    )
