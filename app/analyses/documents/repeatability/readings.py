"""Which of a table's readings are images, and which another instrument measured."""

from __future__ import annotations

from collections.abc import Iterable

from core.session import MeasuredPose, images_of


def is_image(reading: MeasuredPose) -> bool:
    """Return whether a reading, or the first of a stop's, is an image."""
    return images_of(reading)[0].image is not None


def ids_of(readings: Iterable[MeasuredPose]) -> dict[str, list[str]]:
    """Return the ids of images and of measured poses by their fields, in the readings' order."""
    images: list[str] = []
    measured: list[str] = []
    for reading in readings:
        (images if is_image(reading) else measured).append(reading.measurement_id)
    return {"measurement_ids": images, "measured_pose_ids": measured}
