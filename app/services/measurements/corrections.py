"""Corrections of what a client said about an image; exclusion of measurements from analyses; their deletion.

Pose, cycle, burst index, focus group and joint angles belong to the image: a correction changes them in all of its
measurements.
An exclusion belongs to one measurement, since one target of an image may be covered while another is not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm

from app.errors import Conflict
from app.jobs.queue import ALREADY_MEASURED, measurements_of_image
from app.records.activity import maker_name, note_objects
from app.records.statements import rows_of
from app.records.tables import Measurement, Session
from app.services.installation.context import ServiceContext
from app.services.measurements.acceptance import require_cycle, stored_burst
from app.services.measurements.reading import MeasurementDetail, get_measurement
from app.services.originals import finish_soon, record_removals
from app.services.plausibility import require_joints
from app.services.poses import get_or_create_pose
from app.services.queries import get_or_raise

OF_IMAGE = ("pose_id", "cycle", "burst", "focus_group", "joint_angles_deg")
"""What a correction changes in all measurements of an image."""


def correct_measurement(
    records: orm.Session, measurement_id: str, changes: Mapping[str, Any]
) -> MeasurementDetail:
    """Change the fields named in `changes`: those of `OF_IMAGE`, and `excluded` (a reason, or None).

    Raises NotFound; Conflict where the image has measurements of the same targets at the new pose already;
    InvalidContent where a burst index would be left without a cycle, and for joint angles that are not as many as the
    robot's joints.
    """
    measurement = lock_measurement(records, measurement_id)
    image = measurements_of_image(records, measurement)
    of_image = {name: changes[name] for name in OF_IMAGE if name in changes}
    if "burst" in of_image:
        of_image["burst"] = stored_burst(of_image["burst"])
    stated = [("joint_angles_deg", of_image.get("joint_angles_deg"))]
    require_joints(rows_of(records), measurement.session_id, stated)
    require_cycle(of_image.get("cycle", measurement.cycle), of_image.get("burst", measurement.burst))
    pose_id = of_image.get("pose_id", measurement.pose_id)
    if pose_id != measurement.pose_id:
        _require_free(records, image, pose_id)
        get_or_create_pose(records, measurement.session_id, pose_id)
        of_image["pose_label"] = None  # it was the other pose's
    if of_image:
        for each in image:
            for name, value in of_image.items():
                setattr(each, name, value)
        note_objects(each.id for each in image)
    if "excluded" in changes:
        measurement.excluded = _exclusion(changes["excluded"])
    records.flush()
    return get_measurement(records, measurement_id)


def delete_measurement(installation: ServiceContext, measurement_id: str) -> None:
    """Remove a measurement, its result, and its original unless another measurement names it. Raises NotFound.

    A job that computes it just now finds its row gone, and its result is dropped. A sibling that was found by a search
    of the same image searches no more, or it would bring this one back. A row that only says that its image was
    measured goes with the last measurement. A file that cannot be removed now is removed later.
    """
    with installation.database.write() as records:
        measurement = lock_measurement(records, measurement_id)
        others = [each for each in measurements_of_image(records, measurement) if each is not measurement]
        going = [measurement_id]
        if all(each.failure_code == ALREADY_MEASURED.code for each in others):
            going += [each.id for each in others]
        for each in others:
            if each.target_id is not None:
                each.seeks_target = False
        records.flush()
        note_objects(going)
        originals = record_removals(records, Measurement.id.in_(going))
        records.execute(
            sa.delete(Measurement).where(Measurement.id.in_(going)),
            execution_options={"synchronize_session": False},
        )
    finish_soon(installation.database, installation.blobs, originals)


def lock_measurement(records: orm.Session, measurement_id: str) -> Measurement:
    """Return a measurement once no other writer can change its image's measurements. Raises NotFound.

    The session's lock comes first, in the order in which all writers take the two.
    """
    measurement = get_or_raise(records, Measurement, measurement_id)
    get_or_raise(records, Session, measurement.session_id, lock=True)
    records.expire(measurement)
    return get_or_raise(records, Measurement, measurement_id, lock=True)


def _require_free(records: orm.Session, image: Sequence[Measurement], pose_id: str) -> None:
    """Raise Conflict where the image is at this pose already, searched or with one of the same targets."""
    targets = {each.target_id for each in image if each.target_id is not None}
    same = [Measurement.target_id.in_(targets)]
    if any(each.seeks_target for each in image):
        same.append(Measurement.seeks_target.is_(True))
    there = records.scalar(
        sa.select(Measurement.id)
        .where(
            Measurement.session_id == image[0].session_id,
            Measurement.pose_id == pose_id,
            Measurement.sha256 == image[0].sha256,
            sa.or_(*same),
        )
        .order_by(Measurement.id)
        .limit(1)
    )
    if there is not None:
        raise Conflict(
            f"The same image is at pose {pose_id} already, as measurement {there}.",
            "Exclude one of the two with a reason (PATCH `excluded`, `gridpose measurements exclude`), or delete it "
            "(DELETE, `gridpose measurements delete`, with a key of scope admin) and repeat this.",
            code="image_already_at_pose",
            errors=[("pose_id", "has a measurement of the same image and target")],
        )


def _exclusion(reason: str | None) -> dict[str, Any] | None:
    if reason is None:
        return None
    return {
        "reason": reason,
        "by": maker_name(),
        "at": datetime.now(UTC).isoformat(),
    }
