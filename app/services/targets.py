"""Printed targets: their grid is made once and never changed, so that results always refer to what was measured; what
is known of the print may be. Deleted unused.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm

from app.errors import Conflict, InvalidContent
from app.jobs.validation import validate_target
from app.records.ids import new_id
from app.records.tables import Measurement, SessionTarget, Target, measured_target_fields
from app.services.plausibility import check_certificate, check_pitch_uncertainty
from app.services.queries import MAX_NAMED, get_or_raise, lock_for_deletion


@dataclass(frozen=True, slots=True, kw_only=True)
class NewTarget:
    """What a client says about a target."""

    name: str
    kind: str
    columns: int
    rows: int
    pitch_mm: float
    marker_mm: float | None
    dictionary: str | None
    legacy_layout: bool
    pitch_standard_uncertainty_mm: float | None
    print_kind: str | None = None
    shape_standard_uncertainty: dict[str, Any] | None = None
    certificate: dict[str, Any] | None = None


def create_target(session: orm.Session, new: NewTarget) -> Target:
    """Store a target. Raises InvalidContent for one that cannot be."""
    _check_issue(new.certificate)
    target = Target(
        id=new_id("tgt"),
        name=new.name,
        kind=new.kind,
        columns=new.columns,
        rows=new.rows,
        pitch_mm=new.pitch_mm,
        marker_mm=new.marker_mm,
        dictionary=new.dictionary,
        legacy_layout=new.legacy_layout,
        pitch_standard_uncertainty_mm=new.pitch_standard_uncertainty_mm,
        print_kind=new.print_kind,
        shape_standard_uncertainty=new.shape_standard_uncertainty,
        certificate=new.certificate,
        created_at=datetime.now(UTC),
    )
    _check(target)
    session.add(target)
    return target


def update_target(
    records: orm.Session, target_id: str, changes: Mapping[str, Any], *, accept_implausible: bool = False
) -> Target:
    """Change the fields named in `changes`: the name, and what is known of the print.

    Analyses use the change from now on; what images showed stays. Raises NotFound, and InvalidContent as
    `create_target` does, and for an uncertainty that looks like another unit, unless that is accepted.
    """
    target = get_or_raise(records, Target, target_id, lock=True)
    _check_issue(changes.get("certificate"))
    if not accept_implausible:
        check_pitch_uncertainty(
            target.pitch_mm, changes.get("pitch_standard_uncertainty_mm"), changes.get("certificate")
        )
    for field, value in changes.items():
        setattr(target, field, value)
    _check(target)
    records.flush()
    return target


def _check(target: Target) -> None:
    check_certificate(target.certificate, target.pitch_mm, max(target.columns, target.rows) - 1)
    validate_target(measured_target_fields(target, None))


def _check_issue(certificate: Mapping[str, Any] | None) -> None:
    """Raise InvalidContent for a day of issue that does not exist or is to come; somewhere it may be tomorrow."""
    issued_on = (certificate or {}).get("issued_on")
    if issued_on is None:
        return
    try:
        is_past = date.fromisoformat(issued_on) <= datetime.now(UTC).date() + timedelta(days=1)
    except ValueError:
        is_past = False
    if not is_past:
        raise InvalidContent(
            "The certificate's day of issue does not exist or is in the future.",
            "State issued_on as the certificate has it, YYYY-MM-DD, or null where it is not known.",
            errors=[("certificate.issued_on", "must be a day that exists, not after today")],
        )


def delete_target(records: orm.Session, target_id: str) -> None:
    """Delete a target that no session and no measurement refers to. Raises NotFound, Conflict."""
    target = lock_for_deletion(records, Target, target_id)
    for column, verb in (
        (SessionTarget.session_id, "look at the target"),
        (Measurement.session_id, "have measurements of the target"),
    ):
        sessions = records.scalars(
            sa.select(column)
            .where(column.class_.target_id == target_id)
            .distinct()
            .order_by(column)
            .limit(MAX_NAMED)
        ).all()
        if sessions:
            raise Conflict(
                f"Sessions {verb}: {', '.join(sessions)}.",
                "Change the sessions' target_ids (PATCH /v1/sessions/{session_id}, `gridpose sessions change`), which "
                "searches their images again; delete measurements that still name it, or the sessions.",
                code="target_in_use",
                errors=[("session_id", session_id) for session_id in sessions],
            )
    records.delete(target)
