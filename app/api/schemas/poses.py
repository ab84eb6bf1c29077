"""Commanded poses as JSON."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from app.api.schemas.common import RequestModel, ResponseModel, StoredPage
from app.api.schemas.fields import (
    CommandedApproach,
    CommandedPitch,
    CommandedPosition,
    CommandedRoll,
    CommandedYaw,
    PoseId,
    PoseIdField,
    StatedAngles,
    StoredAngles,
    StoredApproach,
    StoredPitch,
    StoredPosition,
    StoredRoll,
    StoredYaw,
)


class PoseReference(RequestModel):
    """What names a pose."""

    pose_id: PoseIdField


class CommandWrite(RequestModel):
    """What a robot was commanded; each of the values may be unknown."""

    position_mm: CommandedPosition = None
    roll_deg: CommandedRoll = None
    pitch_deg: CommandedPitch = None
    yaw_deg: CommandedYaw = None
    joint_angles_deg: StatedAngles = None


class CommandRead(ResponseModel):
    """What a robot was commanded at a pose, or is to be."""

    pose_id: PoseId
    position_mm: StoredPosition
    roll_deg: StoredRoll
    pitch_deg: StoredPitch
    yaw_deg: StoredYaw
    joint_angles_deg: StoredAngles


class PoseWrite(CommandWrite):
    """The commanded values of a pose; each of them may be unknown."""

    approach: CommandedApproach = None


class PoseItem(PoseWrite, PoseReference):
    """One pose of a bulk list."""


MAX_POSES = 20_000
PoseList = Annotated[list[PoseItem], Field(max_length=MAX_POSES)]


class PoseRead(CommandRead):
    """A pose as stored; a pose first named by an image has nulls."""

    approach: StoredApproach


class PosePage(StoredPage):
    """One page of a session's poses."""

    items: Annotated[
        list[PoseRead], Field(description="Poses, in the order in which they were first stored.")
    ]
