"""What came of a session's images, in one sentence: how many were measured, and what determines the camera."""

from __future__ import annotations

from collections.abc import Sequence

from .http import ClientError, Json, ServiceClient

POINTS_SERVE = "focal_not_observable"
"""Failure of an image that has no pose by itself; its grid points count in the session's camera."""
_MEASURED_BEFORE = "target_already_measured"


def is_measured(measurement: Json) -> bool:
    """Return whether the target was found and measured, by the image itself or in the session's camera."""
    failure = measurement["failure"] or {}
    return bool(measurement["status"] == "succeeded" or failure.get("code") == POINTS_SERVE)


def session_cameras(client: ServiceClient, session_id: str) -> tuple[list[Json] | None, list[Json]]:
    """Return the camera of each focus group from all its images, or None where they do not determine it; and the
    measurements that do not count in them, each with its reason.
    """
    try:
        found = client.get(f"/v1/sessions/{session_id}/intrinsics")
    except ClientError as error:
        if error.status in (403, 409):  # a key that may not read, or images that do not suffice
            return None, []
        raise
    return found["groups"], found["excluded"]


def is_alone(measurement: Json) -> bool:
    """Return whether the image determines the camera by itself, to 2 % of the focal length."""
    return bool((measurement["calibration"] or {}).get("grade") == "determined")


def outcome_in_words(measurement: Json) -> str:
    """Return what came of an image; one whose grid points serve is measured, whether or not it gives a camera."""
    if measurement["status"] in ("queued", "running"):
        return str(measurement["status"])
    if measurement["status"] == "succeeded":
        return "measured"
    if is_measured(measurement):
        return "measured, no pose by itself"
    return "measured before" if measurement["failure"]["code"] == _MEASURED_BEFORE else "not measured"


def image_of(measurement: Json) -> tuple[str, str]:
    """Return what all measurements of one image have in common: several where it shows several targets."""
    return measurement["pose_id"], measurement["sha256"]


def describe_measured(measurements: Sequence[Json], cameras: Sequence[Json] | None) -> str:
    """Return the sentence for a session's measurements and its cameras, as `session_cameras` gives them first.

    An image counts once, whatever number of targets it shows.
    """
    measured = {image_of(m) for m in measurements if is_measured(m)}
    determined = len({image_of(m) for m in measurements if is_alone(m)})
    said = f"{len(measured)} {'photograph' if len(measured) == 1 else 'photographs'} measured"
    if not measured:
        return said
    if not cameras:
        if len(measured) == 1:
            return f"{said}, which does not determine the camera: further views are needed, tilted to other sides"
        return f"{said}, which do not determine the camera yet, not even together"
    worst = max(c["standard_uncertainty"]["fx_px"] / c["intrinsics"]["fx_px"] for c in cameras)
    if len(measured) == 1:
        return f"{said}: focal length ± {100.0 * worst:.2g} %"
    alone = "determines" if determined == 1 else "determine"
    own = "itself" if determined == 1 else "themselves"
    does = "the session's camera does" if len(cameras) == 1 else f"the session's {len(cameras)} cameras do"
    return f"{said}; {determined} {alone} the camera by {own}, {does} (± {100.0 * worst:.2g} %)"
