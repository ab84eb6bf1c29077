"""Drawings as answers: which format the client prefers, and what an overlay is of."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from fastapi import Header

from app.api.dependencies import AppContext
from app.api.representations.preferences import qualities
from app.api.responses import measurement_document
from app.jobs.painting import OverlaySubject
from app.services import measurements

if TYPE_CHECKING:  # the head process does without OpenCV
    from app.reports.overlay import MediaType

OCTETS = "application/octet-stream"
AcceptHeader = Annotated[
    str | None,
    Header(
        alias="Accept",
        max_length=1000,
        description="`image/webp` for WebP, which is a third of the size; otherwise the drawing is PNG.",
    ),
]


def preferred_media_type(accept: str | None) -> MediaType:
    """Return WebP where an Accept header names it no lower than PNG, else PNG (RFC 9110, 12.5.1)."""
    found = qualities(accept)
    webp = found.get("image/webp", 0.0)
    return "image/webp" if webp > 0.0 and webp >= found.get("image/png", 0.0) else "image/png"


def stated_media_type(accept: str | None, media_type: str) -> str:
    """Return how a file of an image type is declared: as plain bytes where Accept prefers these, else as what it is."""
    found = qualities(accept)
    family = f"{media_type.partition('/')[0]}/*"
    as_it_is = max(found.get(name, 0.0) for name in (media_type, family, "*/*"))
    return OCTETS if found.get(OCTETS, 0.0) > as_it_is else media_type


def binary_content(*media_types: str) -> dict[str, Any]:
    """Return the documentation of a binary body: its own types, and plain bytes."""
    return {name: {"schema": {"type": "string", "format": "binary"}} for name in (*media_types, OCTETS)}


def draw_overlay(
    service: AppContext, measurement_id: str, width_px: int, media_type: MediaType, requester: str | None
) -> bytes:
    """Return a measurement's overlay as it is now; raises as `ImagePainter` does, and RowUnreadable."""
    measurement, path = measurements.find_original(service.installation, measurement_id)
    with service.installation.database.read() as records:
        points = measurements.get_points(records, measurement_id)
        document = measurement_document(measurements.get_measurement(records, measurement_id))
        target = measurements.sought_target(records, measurement)
        subject = OverlaySubject(
            document.model_dump(),
            points,
            target.kind if target is not None else None,
            target.pitch_mm if target is not None else None,
        )
    return service.painter.overlay(path, measurement.sha256, subject, width_px, media_type, requester)
