"""What an answer is about: the session, its robot and targets by id and name, and when its images were taken."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from app.records.ids import moment_of
from app.records.tables import Robot, Session, Target


def session_subject(
    session: Session,
    robot: Robot | None,
    targets: Sequence[Target],
    captured: Iterable[datetime | None],
    qualification: Mapping[str, Any] | None,
) -> dict[str, Any]:
    """Return the subject of a session's analyses.

    `captured` are the times of its images, None where not stated; `qualification` is the latest of its set-up
    (`app.services.qualifications`), None for none.
    """
    times = [moment for moment in captured if moment is not None]
    return {
        "session": _named(session),
        "robot": _named(robot) if robot is not None else None,
        "targets": [_named(target) for target in targets],
        "first_captured_at": _rfc3339(min(times)) if times else None,
        "last_captured_at": _rfc3339(max(times)) if times else None,
        "conditions": session.conditions,
        "qualification": None
        if qualification is None
        else {
            "id": qualification["id"],
            "made_at": _rfc3339(qualification["made_at"]),
            "due_at": _rfc3339(qualification["due_at"]),
            "decision": qualification["decision"],
        },
        "camera_mount": session.camera_mount,
    }


def subject_in_words(subject: Mapping[str, Any]) -> str:
    """Return session, robot and date in a line, names in full.

    The date is that of the images where any states when it was taken, else that on which the session began. All of it
    is in the tags of answers (`Snapshot.answer_sha256`), so that what is kept never bears another name.
    """
    parts = [subject["session"]["name"]]
    if subject["robot"] is not None:
        parts.append(f"robot {subject['robot']['name']}")
    if subject["first_captured_at"] is None:
        parts.append(f"session of {moment_of(subject['session']['id']).date().isoformat()}")
    else:
        days = [subject[name][:10] for name in ("first_captured_at", "last_captured_at")]
        parts.append(f"images of {' to '.join(dict.fromkeys(days))}")
    return " · ".join(parts)


def _named(row: Session | Robot | Target) -> dict[str, str]:
    return {"id": row.id, "name": row.name}


def _rfc3339(moment: datetime) -> str:
    return moment.astimezone(UTC).isoformat().replace("+00:00", "Z")
