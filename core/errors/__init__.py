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
            ├── JointSignReversed        joint_sign_reversed
            ├── JointNotExcited          joint_not_excited
            ├── TooFewPoses              too_few_poses
            ├── ArcTooShort              arc_too_short
            ├── RotationsMissing         rotations_required
            └── PrismaticJoint           prismatic_joint

`code` is stable and snake_case, `detail` says what happened with its figures, `advice` says what to do next.
"""

from core.errors.base import (
    ADVISED_TILT,
    MAX_LISTED,
    Advisory,
    GridposeError,
    listed,
)
from core.errors.estimation import (
    ArcTooShort,
    DegenerateGeometry,
    EstimationError,
    FocalNotObservable,
    FocalWeaklyObservable,
    FrameMirrored,
    JointAnglesInconsistent,
    JointAnglesMissing,
    JointAnglesUnitMismatch,
    JointNotExcited,
    JointSignReversed,
    KinematicsError,
    LengthsUnitMismatch,
    MotionInsufficient,
    NotConverged,
    PoseAmbiguous,
    PrismaticJoint,
    RotationsMissing,
    TargetShapeNotObservable,
    TooFewPoses,
)
from core.errors.images import (
    DetectionError,
    EmptyImage,
    ImageError,
    ImageTooManyPixels,
    InvalidArgument,
    InvalidInput,
    InvalidTarget,
    OriginUnknown,
    TargetAmbiguous,
    TargetMirrored,
    TargetMismatch,
    TargetNotFound,
    UndecodableImage,
    UnsupportedImage,
)
from core.errors.sessions import (
    CommandedPosesMissing,
    IntrinsicsMissing,
    MeasuredPosesMissing,
    MixedImageSizes,
    NominalRobotMissing,
    NothingUsable,
    NoViewShowsTarget,
    RobotBaseMismatch,
    SessionError,
    SeveralTargetsOnFlange,
    SweepJointUnknown,
    SweepPoseUnknown,
    TooFewCycles,
    TooFewMeasurements,
    TooManyMeasurements,
    WitnessUnusable,
)

__all__ = [
    "ADVISED_TILT",
    "MAX_LISTED",
    "Advisory",
    "ArcTooShort",
    "CommandedPosesMissing",
    "DegenerateGeometry",
    "DetectionError",
    "EmptyImage",
    "EstimationError",
    "FocalNotObservable",
    "FocalWeaklyObservable",
    "FrameMirrored",
    "GridposeError",
    "ImageError",
    "ImageTooManyPixels",
    "IntrinsicsMissing",
    "InvalidArgument",
    "InvalidInput",
    "InvalidTarget",
    "JointAnglesInconsistent",
    "JointAnglesMissing",
    "JointAnglesUnitMismatch",
    "JointNotExcited",
    "JointSignReversed",
    "KinematicsError",
    "LengthsUnitMismatch",
    "MeasuredPosesMissing",
    "MixedImageSizes",
    "MotionInsufficient",
    "NoViewShowsTarget",
    "NominalRobotMissing",
    "NotConverged",
    "NothingUsable",
    "OriginUnknown",
    "PoseAmbiguous",
    "PrismaticJoint",
    "RobotBaseMismatch",
    "RotationsMissing",
    "SessionError",
    "SeveralTargetsOnFlange",
    "SweepJointUnknown",
    "SweepPoseUnknown",
    "TargetAmbiguous",
    "TargetMirrored",
    "TargetMismatch",
    "TargetNotFound",
    "TargetShapeNotObservable",
    "TooFewCycles",
    "TooFewMeasurements",
    "TooFewPoses",
    "TooManyMeasurements",
    "UndecodableImage",
    "UnsupportedImage",
    "WitnessUnusable",
    "listed",
]
