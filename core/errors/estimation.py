"""What points, poses or joint angles do not determine."""

from __future__ import annotations

from core.errors.base import ADVISED_TILT, GridposeError


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
        "the columns of the import, too. If the frame is right-handed, joint 1 may count the other way."
    )


class JointSignReversed(KinematicsError):
    code = "joint_sign_reversed"
    default_advice = "Reverse the sign of this joint's angles, or correct the nominal robot."


class JointNotExcited(KinematicsError):
    code = "joint_not_excited"
    default_advice = (
        "Add a sweep of this joint: poses at which it alone moves and the others rest. If the joint slides and rests "
        "at one travel, describe the robot without it (its travel counts in d_mm of a neighbour about the same axis), "
        "and send the angles of the other joints alone. If linkages turn it with other joints, as the hand of a "
        "palletizer that stays level, state joint_coupling with the robot."
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
