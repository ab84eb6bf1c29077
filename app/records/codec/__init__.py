"""A calibration as a `results` row, and its grid points and markers back again without loss.

The row holds the document that the API shows (`results`: degrees, named fields; floats keep every bit as JSON) and,
alongside it, the grid points and markers as bytes (`points`). Analyses of thousands of rows read these bytes and never
open an image again.
"""

from app.records.codec.points import (
    POINT_BYTES,
    are_markers,
    are_points,
    content_hash,
    decode_markers,
    decode_stack,
    point_places,
    points_documents,
)
from app.records.codec.results import calibration_document, encode_calibration, encode_refused

__all__ = [
    "POINT_BYTES",
    "are_markers",
    "are_points",
    "calibration_document",
    "content_hash",
    "decode_markers",
    "decode_stack",
    "encode_calibration",
    "encode_refused",
    "point_places",
    "points_documents",
]
