"""A calibration as a row, and back again without loss.

The row (`results`) holds the document the API shows (`document`: degrees, named fields). Beside it stand the
calibration's arrays and those of its `points` and markers as bytes; `remarks` and the picture's quality are JSON,
angles in radians. Analyses over thousands of rows read these and never open an image again. `outcome` is what a job
brings back.
"""

from app.records.codec.document import calibration_document
from app.records.codec.outcome import Failure, Outcome, Provenance, Shown
from app.records.codec.points import (
    decode_markers,
    decode_points,
    decode_stack,
    end_points,
    points_documents,
    rename_points,
)
from app.records.codec.remarks import decode_quality
from app.records.codec.results import decode_calibration, encode_calibration, encode_refused

__all__ = [
    "Failure",
    "Outcome",
    "Provenance",
    "Shown",
    "calibration_document",
    "decode_calibration",
    "decode_markers",
    "decode_points",
    "decode_quality",
    "decode_stack",
    "encode_calibration",
    "encode_refused",
    "end_points",
    "points_documents",
    "rename_points",
]
