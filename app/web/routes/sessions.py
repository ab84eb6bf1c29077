"""A session's page: its images as they come, by state, pose and code."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, get_args

import sqlalchemy as sa
from fastapi import Query, Request
from sqlalchemy import orm
from starlette.responses import Response

from app.records.tables import Robot, Session, Target
from app.services.measured_poses import source_of
from app.services.measurements import (
    GalleryCounts,
    GalleryFilter,
    ImageState,
    count_gallery,
    list_gallery,
)
from app.services.readings import count_readings, readings_by_pose, readings_of_pose
from app.services.sessions import SessionDetail, get_session
from app.web.health import count_idle, no_worker
from app.web.pages import is_fragment, page_router, query_of, render
from app.web.service import service_of

router = page_router()
PAGE_SIZE = 60
FOCAL_LEFT_OPEN = "focal_not_observable"
ISO_CYCLES = 30
"""Cycles of a test by ISO 9283:1998, 7.2."""
_STATES = get_args(ImageState)


@router.get("/sessions/{session_id}", operation_id="get_session")
def show_session(
    request: Request,
    session_id: str,
    state: Annotated[str, Query(max_length=16)] = "",
    pose: Annotated[str, Query(max_length=128)] = "",
    code: Annotated[str, Query(max_length=64)] = "",
    order: Annotated[str, Query(max_length=16)] = "newest",
    page: Annotated[int, Query(ge=1, le=1_000_000)] = 1,
    source: Annotated[str, Query(max_length=40)] = "",
) -> Response:
    """Show a session's images, newest first unless asked otherwise; of a session without any another instrument's
    readings.
    """
    chosen = GalleryFilter(
        state=state if state in _STATES else None,  # type: ignore[arg-type]
        pose_id=pose or None,
        code=code or None,
        oldest_first=order == "oldest",
    )
    asked = {"state": state, "pose": pose, "code": code, "order": order}
    with service_of(request).installation.database.read() as records:
        detail = get_session(records, session_id)
        own_source = source_of(records, session_id)
        if (source or own_source) == "measured_poses":
            context = session_context(records, detail, "images")
            return render(request, "sessions/readings.html", **context, **_readings(records, detail, pose))
        shown = list_gallery(records, session_id, chosen, page=page, size=PAGE_SIZE)
        counted = count_gallery(records, session_id)
        context = {
            **session_context(records, detail, "images"),
            "gallery": shown,
            "counted": counted,
            "chosen": asked,
            "page_address": lambda number: f"/ui/sessions/{session_id}{query_of(asked, page=number)}",
            "advice": next_step(detail, counted),
            "url": str(request.base_url).rstrip("/"),
        }
        waits = bool(detail.counts["queued"]) and not is_fragment(request)
        idle = count_idle(service_of(request), records) if waits else 0
        context["idle"] = no_worker(idle) if idle else ""
        return render(
            request, "sessions/_gallery.html" if is_fragment(request) else "sessions/session.html", **context
        )


def session_context(records: orm.Session, detail: SessionDetail, tab: str) -> dict[str, Any]:
    """Return what every page of a session shows in its head: name, robot, targets, counts."""
    session: Session = detail.session
    robot = records.get(Robot, session.robot_id) if session.robot_id is not None else None
    ids = [target.target_id for target in session.targets]
    targets = records.scalars(sa.select(Target).where(Target.id.in_(ids))).all()
    return {
        "session": session,
        "session_id": session.id,
        "counts": detail.counts,
        "robot": robot,
        "targets": sorted(targets, key=lambda target: ids.index(target.id)),
        "readings": count_readings(records, [session.id])[session.id],
        "tab": tab,
    }


def _readings(records: orm.Session, detail: SessionDetail, pose_id: str) -> dict[str, Any]:
    """Return what the page of another instrument's readings shows: all poses, or the readings of one."""
    poses = readings_by_pose(records, detail.session.id)
    return {
        "poses": poses,
        "chosen": pose_id,
        "shown": readings_of_pose(records, detail.session.id, pose_id) if pose_id else [],
        "shows_images": any(detail.counts.values()),
        "advice": few_cycles(poses, "readings") or "All poses have the cycles that ISO 9283 asks for.",
    }


def few_cycles(poses: Sequence[tuple[str, int]], nouns: str) -> str | None:
    """Return which poses have fewer cycles than the standard asks for, counted by their cycles or readings."""
    few = [count for _, count in poses if count < ISO_CYCLES]
    if not few:
        return None
    return (
        f"{len(few)} of {len(poses)} poses have fewer than {ISO_CYCLES} {nouns}, which ISO 9283 asks for; the fewest "
        f"are {min(few)}. Intervals narrow with more cycles."
    )


def next_step(detail: SessionDetail, counted: GalleryCounts) -> tuple[str, str, str] | None:
    """Return what to do next: a sentence, the page to go to, and the link's text; None while images are computed."""
    counts, session_id = detail.counts, detail.session.id
    done = counts["succeeded"] + counts["failed"]
    if not done and not counts["queued"] and not counts["running"]:
        return (
            "No image is here yet. Add images, or let the robot's PC send them.",
            f"/ui/sessions/{session_id}/upload",
            "Add images",
        )
    if counts["queued"] or counts["running"]:
        return None
    # Images that do not determine the focal length by themselves count in the session's camera.
    reasons = [(code, count) for code, count in counted.codes if code != FOCAL_LEFT_OPEN]
    unmeasured = counts["failed"] - sum(count for code, count in counted.codes if code == FOCAL_LEFT_OPEN)
    if unmeasured > 0.2 * done:
        code = reasons[0][0] if reasons else ""
        return (
            f"{unmeasured} of {done} images were not measured, most often {code.replace('_', ' ')}. Open one: it says "
            "why and what to change.",
            f"/ui/sessions/{session_id}?state=failed",
            "See these images",
        )
    if counted.poses and all(count == 1 for _, count in counted.poses):
        return (
            "No pose has two images: these determine the camera. Repeatability takes images of the same pose again and "
            "again, tagged with their cycle.",
            f"/ui/sessions/{session_id}/camera",
            "See the camera",
        )
    few = few_cycles(counted.cycles, "cycles")
    return few or "All images are measured.", f"/ui/sessions/{session_id}/repeatability", "See repeatability"
