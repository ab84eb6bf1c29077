"""What came of a session's images, in one sentence: how many were measured, and what determines the camera."""

from __future__ import annotations

from collections.abc import Sequence

from .http import ClientError, Json, ServiceClient

POINTS_SERVE = "focal_not_observable"
"""Failure of an image that has no pose by itself; its grid points count in the session's camera."""


def is_measured(measurement: Json) -> bool:
    """Return whether the target was found and measured, by the image itself or in the session's camera."""
    failure = measurement["failure"] or {}
    return bool(measurement["status"] == "succeeded" or failure.get("code") == POINTS_SERVE)


def session_cameras(client: ServiceClient, session_id: str) -> list[Json] | None:
    """Return the camera of each focus group from all its images, or None where they do not determine it."""
    try:
        groups: list[Json] = client.get(f"/v1/sessions/{session_id}/intrinsics")["groups"]
    except ClientError as error:
        if error.status in (403, 409):  # a key that may not read, or images that do not suffice
            return None
        raise
    return groups


def describe_measured(measurements: Sequence[Json], cameras: Sequence[Json] | None) -> str:
    """Return the sentence for a session's measurements and its cameras, as `session_cameras` gives them."""
    measured = [m for m in measurements if is_measured(m)]
    grades = [(m["calibration"] or {}).get("grade") for m in measured]
    determined = grades.count("determined")
    images = "photograph" if len(measured) == 1 else "photographs"
    alone = "determines" if determined == 1 else "determine"
    own = "itself" if determined == 1 else "themselves"
    said = f"{len(measured)} {images} measured; {determined} {alone} the camera by {own}"
    if not measured:
        return said
    if not cameras:
        return f"{said}, and together they do not determine it yet"
    worst = max(c["standard_uncertainty"]["fx_px"] / c["intrinsics"]["fx_px"] for c in cameras)
    does = "the session's camera does" if len(cameras) == 1 else f"the session's {len(cameras)} cameras do"
    return f"{said}, {does} (± {100.0 * worst:.2g} %)"
