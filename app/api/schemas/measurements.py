"""Images and measurements as JSON."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import ConfigDict, FailFast, Field
from typing_extensions import TypeAliasType

from app.api.schemas.camera import CalibrationRead
from app.api.schemas.common import (
    POSE_LABEL,
    AdvisoryRead,
    Burst,
    Cycle,
    FailureRead,
    Identifier,
    JointAngles,
    PoseTag,
    RequestModel,
    ResponseModel,
    Sha256,
    Share,
    StoredPage,
    Text,
)
from app.api.schemas.fields import BURST, CYCLE, JOINT_ANGLES, FocusGroup, PoseId, SessionId

MeasurementStatus = TypeAliasType(
    "MeasurementStatus",
    Annotated[
        Literal["queued", "running", "succeeded", "failed"],
        Field(description="How far the computation of a measurement is."),
    ],
)
Labelling = TypeAliasType(
    "Labelling",
    Annotated[
        Literal["absolute", "up_to_symmetry", "partial"],
        Field(description="How far an image determines which grid point is (0, 0)."),
    ],
)


class ImageName(RequestModel):
    """An image by the pose it was taken at, its hash, and the target that its upload names."""

    pose_id: PoseTag = Field(description="The pose the image was taken at.", examples=["P7"])
    sha256: Sha256 = Field(description="SHA-256 of the file, 64 hex digits.", examples=["0" * 64])
    target_id: Identifier | None = Field(
        default=None,
        description="One of the session's targets; null: the image is searched for all of them.",
        examples=["tgt_01m82cfvpb6qj0acpan13hkzgq"],
    )


MAX_IMAGE_NAMES = 20_000


class ImageList(RequestModel):
    """Images that a client has."""

    # Programs make these lists: the first wrong item says all that is wrong with them.
    images: Annotated[
        list[ImageName],
        Field(max_length=MAX_IMAGE_NAMES, description="The images to look for, 20,000 at most."),
        FailFast(),
    ]


class MissingImages(ResponseModel):
    """Images that the session does not have."""

    missing: list[ImageName] = Field(
        description="Those to be sent, in the order asked for; empty: all are here."
    )


class GridPointRead(ResponseModel):
    """One grid point that was found in the image."""

    column: int = Field(description="The grid point's column in the target, from 0 along x.")
    row: int = Field(description="The grid point's row in the target, from 0 along y.")
    u_px: float = Field(
        description="Observed image coordinate to the right, px; 0 is the leftmost pixel's centre."
    )
    v_px: float = Field(description="Observed image coordinate down, px; 0 is the topmost pixel's centre.")
    standard_uncertainty_px: float = Field(
        description="Standard uncertainty of each of the two coordinates, px."
    )
    residual_u_px: float | None = Field(
        description="Observed minus predicted u, px; null where no camera was fitted."
    )
    residual_v_px: float | None = Field(
        description="Observed minus predicted v, px; null where no camera was fitted."
    )
    used: bool | None = Field(
        description="Whether the fit used the point; false: rejected as an outlier; null where no camera was fitted."
    )


class CaptureQualityRead(ResponseModel):
    """Quality of the image where the target is; a figure is null where the image does not determine it."""

    edge_width_px: float | None = Field(description="10-90 % rise distance of the sharpest edges, px.")
    motion_blur_px: float | None = Field(
        description="Length of the uniform motion that would widen edges as much more in one direction than across it."
    )
    motion_blur_direction_deg: float | None = Field(
        description="That direction, from u toward v, from 0 to 180."
    )
    saturated_fraction: Share | None = Field(description="Share of the target's white at the sensor's top.")
    clipped_fraction: Share | None = Field(description="Share of the target's black at the sensor's bottom.")
    contrast: float | None = Field(description="White less black, as a fraction of full scale.")
    coverage_fraction: Share = Field(description="Share of the image within the grid points' outline.")
    tilt_deg: float | None = Field(
        description="Angle between the target's normal and the optical axis, degrees: by the image's calibration, "
        "else for a usual lens."
    )
    warnings: list[AdvisoryRead] = Field(
        description="What would improve the image, the most effective first; empty for a good one."
    )


class ExclusionRead(ResponseModel):
    """Why a user keeps a measurement out of analyses."""

    reason: str = Field(description="The user's reason; analyses repeat it.", examples=["A hand in front."])
    by: str | None = Field(
        description="Name of the key that excluded it; null without keys.", examples=["cell 7"]
    )
    at: datetime = Field(
        description="When it was excluded, RFC 3339 in UTC.", examples=["2026-01-31T12:00:00Z"]
    )


class Exclusion(RequestModel):
    """Keep a measurement out of analyses."""

    reason: Text = Field(description="Why; analyses repeat it.", examples=["A hand in front of the board."])


class MeasurementChange(RequestModel):
    """What to correct of an image; fields left away stay as they are.

    `pose_id`, `cycle`, `burst`, `focus_group` and `joint_angles_deg` belong to the image and change in all of its
    measurements (`siblings`); `excluded` changes in this one alone. Results stay.
    """

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"pose_id": "P7", "cycle": 3}, {"excluded": {"reason": "Moved."}}]}
    )

    # The factories make the fields optional without allowing null; what was not sent is never looked at.
    pose_id: PoseTag = Field(
        default_factory=str,
        description="The pose the image was taken at; one that is named here first is made.",
        examples=["P7"],
    )
    cycle: Cycle | None = Field(
        default=None,
        description="Which of the repeated visits to the pose, from 1; null: not known.",
        examples=[3],
    )
    burst: Burst | None = Field(default=None, description=f"{BURST} Null: 1.", examples=[2])
    focus_group: Text = Field(
        default_factory=str,
        description="Tag that the images of one camera setting share.",
        examples=["default"],
    )
    joint_angles_deg: JointAngles | None = Field(
        default=None,
        description="Joint angles of the image; null: those of its pose.",
        examples=[[10.0, -45.0, 90.0, 0.0, 45.0, 0.0]],
    )
    excluded: Exclusion | None = Field(
        default=None,
        description="Keep this measurement out of analyses, which list it with the reason; null lets it count again.",
        examples=[{"reason": "A hand in front of the board."}],
    )


class MeasurementRead(ResponseModel):
    """One image and what came of it of one target.

    An image uploaded without `target_id` to a session with several targets becomes a measurement for each target that
    it shows. Until it is searched, and where it shows none, its measurement's `target_id` is null.

    `finished_at`, `duration_ms`, `failure`, `calibration`, `labelling`, `capture_quality` and `points` are of one and
    the same computation. They stay while the measurement is `queued` or `running` again, and analyses use them, until a
    new result replaces them all at once.
    """

    id: str = Field(description="Id of the measurement, made by the server; ids are in the order of receipt.")
    session_id: SessionId
    pose_id: PoseId
    cycle: int | None = Field(description=CYCLE)
    burst: int = Field(description=f"{BURST} 1 where none was stated.")
    target_id: str | None = Field(
        description="The target that was measured in the image; null until it is found, and where none is."
    )
    siblings: list[str] = Field(
        description="The measurements of the same image at the same pose, of other targets; oldest first."
    )
    focus_group: FocusGroup
    joint_angles_deg: list[float] | None = Field(
        description=f"{JOINT_ANGLES} They take precedence over the pose's. Null: the pose's apply."
    )
    captured_at: datetime | None = Field(
        description="When the image was taken, RFC 3339 in UTC, as the client stated it; null: not stated."
    )
    received_at: datetime = Field(
        description="When the server had stored the image durably, RFC 3339 in UTC."
    )
    finished_at: datetime | None = Field(
        description="When the result shown was computed, RFC 3339 in UTC; null before the first one."
    )
    sha256: str = Field(description="SHA-256 of the original file: 64 lower-case hex digits.")
    filename: str | None = Field(
        description="The file's bare name at the client, without folders; null: not stated."
    )
    pose_label: str | None = Field(description=f"{POSE_LABEL} Null: not stated.")
    bytes: int = Field(description="Size of the original file, bytes.")
    status: MeasurementStatus = Field(
        description="`queued`: waits to be computed. `running`: is computed. `succeeded`: has a calibration. `failed`: "
        "has none, for the reason in `failure`."
    )
    attempts: int = Field(
        description="Computations that ended since it was queued, lost workers included; the third lost one fails it."
    )
    duration_ms: float | None = Field(
        description="Time that the result shown took to compute, ms; null before the first one."
    )
    failure: FailureRead | None = Field(
        description="Why the image has no calibration of its own; null where it has one, or before the first result."
    )
    retry_failure: FailureRead | None = Field(
        description="Why the last retry computed nothing, such as `worker_crashed`, `processing_timeout` or "
        "`original_corrupt`: the earlier result stands. Null where there was no retry, or it gave a result."
    )
    excluded: ExclusionRead | None = Field(
        description="Why a user keeps it out of analyses; null where it counts."
    )
    calibration: CalibrationRead | None = Field(
        description="Camera and pose by this image alone; null where it failed, or before the first result."
    )
    labelling: Labelling | None = Field(
        description="How far the image determines which grid point is (0, 0): `absolute` uniquely; `up_to_symmetry` "
        "but for turns of the whole grid that look the same, one of which was chosen; `partial` in results of earlier "
        "versions, for a partial view that fits at several places. Null where no points were found, or before this "
        "was stored."
    )
    capture_quality: CaptureQualityRead | None = Field(
        description="Sharpness, exposure and coverage with advice; null where no target was found, or not measured yet."
    )
    points: list[GridPointRead] | None = Field(
        description="Every grid point found, rejected ones too. Null without `include=points`, or where none was found."
    )


class MeasurementPage(StoredPage):
    """One page of a session's measurements; one that cannot be read is among them, as failed."""

    items: list[MeasurementRead] = Field(description="Measurements, oldest first.")
