"""What a session lacks that an analysis of it needs."""

from __future__ import annotations

from core.errors.base import GridposeError


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
