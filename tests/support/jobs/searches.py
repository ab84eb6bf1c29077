"""Images that name no target, and what a search of all targets of their session gives."""

from __future__ import annotations

from typing import Any

from app.jobs.queue import Job
from app.records.codec import encode_refused
from app.records.outcome import DetectedTarget, Failure, Outcome, Provenance

NOTHING = Failure("target_not_found", "Nothing there.", "Look elsewhere.")


def shown(job: Job, *places: int, failure: Failure | None = None) -> Outcome:
    """An outcome in which the targets at these places of the session's list are shown."""
    nothing = encode_refused(None, Provenance("1", job.sha256, {}))
    return Outcome(
        nothing,
        NOTHING,
        tuple(
            DetectedTarget(job.targets[place].target_id, nothing, failure, 10.0 + place) for place in places
        ),
    )


def seek(api: Any, data: bytes, targets: int = 3) -> tuple[str, list[str], str]:
    """A session with targets and an image that names none: session, targets, measurement."""
    ids = [api.make_target(columns=5 + k) for k in range(targets)]
    session_id = api.make_session(*ids)
    return session_id, ids, api.put_image(session_id, data).json()["id"]
