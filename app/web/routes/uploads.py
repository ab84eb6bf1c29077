"""A new session, a change of one, and adding images and commanded poses to it."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import Annotated

import sqlalchemy as sa
from fastapi import Query, Request
from sqlalchemy import orm
from starlette.responses import Response

from app.records.tables import Measurement, Pose, Robot, Session
from app.services.poses import list_poses
from app.services.queries import get_or_raise, visible
from app.services.sessions import get_session
from app.web.pages import page_router, render
from app.web.routes.planning import known_targets
from app.web.routes.sessions import session_context
from app.web.service import service_of

router = page_router()
POSES_SHOWN = 500
MAX_POSES = 20_000
"""Poses of one file, as many as the API takes at once."""


@router.get("/sessions/new", operation_id="list_sessions")
def show_new_session(request: Request, target: Annotated[str, Query(max_length=64)] = "") -> Response:
    """Ask for a session's target, robot, lens and conditions."""
    with service_of(request).installation.database.read() as records:
        return render(
            request,
            "sessions/new_session.html",
            targets=known_targets(records),
            robots=_robots(records),
            chosen_target=target,
        )


@router.get("/sessions/{session_id}/change", operation_id="update_session")
def show_change(request: Request, session_id: str) -> Response:
    """Ask for another name, target, robot, lens or other conditions of a session."""
    with service_of(request).installation.database.read() as records:
        return render(
            request,
            "sessions/session_change.html",
            **session_context(records, get_session(records, session_id), "change"),
            known_targets=known_targets(records),
            robots=_robots(records),
        )


def _robots(records: orm.Session) -> list[Robot]:
    found = sa.select(Robot).where(*visible(Robot)).order_by(Robot.name).limit(500)
    return list(records.scalars(found))


@router.get("/sessions/{session_id}/upload", operation_id="get_session")
def show_upload(request: Request, session_id: str) -> Response:
    """Take images by drag and drop; scripts hash them and send what is missing."""
    service = service_of(request)
    with service.installation.database.read() as records:
        detail = get_session(records, session_id)
        return render(
            request,
            "sessions/upload.html",
            **session_context(records, detail, "upload"),
            url=str(request.base_url).rstrip("/"),
            cycles=last_cycles(records, session_id),
            max_bytes=service.installation.settings.max_upload_bytes,
        )


def last_cycles(records: orm.Session, session_id: str) -> dict[str, int]:
    """Return the last cycle of each pose of which the session has images with cycles."""
    of_pose = (
        sa.select(Measurement.pose_id, sa.func.max(Measurement.cycle))
        .where(Measurement.session_id == session_id)
        .group_by(Measurement.pose_id)
    )
    return {pose_id: cycle for pose_id, cycle in records.execute(of_pose) if cycle is not None}


@router.get("/sessions/{session_id}/poses", operation_id="list_poses")
def show_poses(request: Request, session_id: str) -> Response:
    """Show the commanded poses and take a table of them; a script reads it, shows it, and stores it by the API."""
    with service_of(request).installation.database.read() as records:
        detail = get_session(records, session_id)
        poses, more = list_poses(records, session_id, limit=POSES_SHOWN, cursor=None)
        joints = max((len(pose.joint_angles_deg or ()) for pose in poses), default=0)
        return render(
            request,
            "sessions/commanded_poses.html",
            **session_context(records, detail, "poses"),
            poses=poses,
            more=more is not None,
            joints=joints,
        )


@router.get("/sessions/{session_id}/poses.csv", operation_id="list_poses")
def get_poses_table(request: Request, session_id: str) -> Response:
    """Give the session's poses as a table to fill in, in the columns that the page takes."""
    with service_of(request).installation.database.read() as records:
        session = get_or_raise(records, Session, session_id)
        known = sa.select(Pose).where(Pose.session_id == session_id).order_by(Pose.id).limit(MAX_POSES)
        poses = records.scalars(known).all()
        robot = records.get(Robot, session.robot_id) if session.robot_id is not None else None
        joints = len(robot.joints) if robot is not None else 0
    headers = {"Content-Disposition": 'attachment; filename="poses.csv"', "Cache-Control": "no-store"}
    return Response(poses_table(poses, joints), media_type="text/csv; charset=utf-8", headers=headers)


def poses_table(poses: Sequence[Pose], joints: int) -> str:
    """Return poses as CSV, lengths in mm and angles in degrees; what is not stated is empty.

    There are columns for `joints` angles, or for as many as a pose has.
    """
    joints = max([joints, *(len(pose.joint_angles_deg or ()) for pose in poses)])
    text = io.StringIO()
    table = csv.writer(text)
    angles = [f"j{k}_deg" for k in range(1, joints + 1)]
    table.writerow(
        ["pose_id", "x_mm", "y_mm", "z_mm", "roll_deg", "pitch_deg", "yaw_deg", *angles, "approach"]
    )
    for pose in poses:
        values = [*(pose.position_mm or [None] * 3), pose.roll_deg, pose.pitch_deg, pose.yaw_deg]
        values += [*(pose.joint_angles_deg or ()), *[None] * (joints - len(pose.joint_angles_deg or ()))]
        table.writerow([pose.pose_id, *values, pose.approach])
    return text.getvalue()
