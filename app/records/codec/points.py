"""Grid points and markers as bytes: one `_POINT` record per grid point, one `_MARKER` record per marker seen, ascending
by id, both little endian."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any, TypeGuard

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration import ViewStack
from core.targets import GridPoints, TargetSpec

_POINT = np.dtype(
    [
        ("column", "<i2"),
        ("row", "<i2"),
        ("u_px", "<f8"),
        ("v_px", "<f8"),
        ("standard_uncertainty_px", "<f8"),
        ("residual_u_px", "<f8"),
        ("residual_v_px", "<f8"),
        ("used", "i1"),
    ]
)
_MARKER = np.dtype([("id", "<i4"), ("corners_px", "<f8", (4, 2))])
POINT_BYTES, MARKER_BYTES = _POINT.itemsize, _MARKER.itemsize
_UNKNOWN = -1  # `used` of a point no fit has looked at; its residuals are NaN


def encode_points(
    points: GridPoints,
    residuals_px: Float[np.ndarray, "n 2"] | None = None,
    used: Bool[np.ndarray, " n"] | None = None,
) -> bytes:
    """Return grid points with their residuals and whether the fit used them; None where no fit looked at them."""
    records = np.zeros(len(points), dtype=_POINT)
    records["column"], records["row"] = points.column, points.row
    records["u_px"], records["v_px"] = points.points_px[:, 0], points.points_px[:, 1]
    records["standard_uncertainty_px"] = points.standard_uncertainty_px
    if residuals_px is None:
        records["residual_u_px"] = records["residual_v_px"] = np.nan
        records["used"] = _UNKNOWN
    else:
        records["residual_u_px"], records["residual_v_px"] = residuals_px[:, 0], residuals_px[:, 1]
        records["used"] = used
    return records.tobytes()


def encode_markers(points: GridPoints) -> bytes | None:
    """Return the corners of the markers seen; None for targets without any."""
    if points.markers_px is None:
        return None
    records = np.zeros(len(points.markers_px), dtype=_MARKER)
    for record, (marker, corners) in zip(records, sorted(points.markers_px.items()), strict=True):
        record["id"], record["corners_px"] = marker, corners
    return records.tobytes()


def content_hash(points: bytes | None, markers: bytes | None) -> str:
    """Return the SHA-256 of all arrays that analyses read of a result, as 64 hex digits.

    Each array is preceded by its length, -1 for a missing array, so that no two contents are joined to the same bytes.
    """
    digest = hashlib.sha256()
    for part in (points, markers):
        digest.update((-1 if part is None else len(part)).to_bytes(8, "little", signed=True))
        digest.update(part or b"")
    return digest.hexdigest()


def decode_stack(
    points: Sequence[bytes],
    targets: Sequence[TargetSpec],
    target: Sequence[int],
    width_px: int,
    height_px: int,
) -> ViewStack:
    """Return the grid points of many stored results of one image size; `target` is each one's place in `targets`."""
    records = np.frombuffer(b"".join(points), dtype=_POINT)
    counts = np.array([len(stored) // _POINT.itemsize for stored in points], dtype=np.intp)
    column, row = records["column"].astype(np.intp), records["row"].astype(np.intp)
    if len(set(target)) == 1:
        places = targets[target[0]].points_target(column, row)
    else:
        of_point = np.repeat(np.array(target, dtype=np.intp), counts)
        places = np.empty((len(records), 3))
        for k in set(target):
            shown = of_point == k
            places[shown] = targets[k].points_target(column[shown], row[shown])
    return ViewStack(
        image_width_px=width_px,
        image_height_px=height_px,
        targets=tuple(targets),
        target=np.array(target, dtype=np.intp),
        first=np.concatenate([[0], np.cumsum(counts)]),
        column=column,
        row=row,
        points_px=np.stack([records["u_px"], records["v_px"]], axis=1),
        standard_uncertainty_px=records["standard_uncertainty_px"].copy(),
        points_target=places,
    )


def are_points(stored: object) -> TypeGuard[bytes]:
    """Return whether a stored value consists of whole records of grid points; anything else cannot be decoded."""
    return isinstance(stored, bytes) and len(stored) % POINT_BYTES == 0


def are_markers(stored: object) -> TypeGuard[bytes]:
    """Return whether a stored value consists of whole records of markers."""
    return isinstance(stored, bytes) and len(stored) % MARKER_BYTES == 0


def point_places(points: bytes) -> tuple[Int[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
    """Return column and row of each stored point, and its place in the image (px)."""
    records = np.frombuffer(points, dtype=_POINT)
    labels = np.stack([records["column"], records["row"]], axis=1).astype(np.intp)
    return labels, np.stack([records["u_px"], records["v_px"]], axis=1)


def decode_markers(markers: bytes) -> dict[int, Float[np.ndarray, "4 2"]]:
    """Return the corners (px) of the markers of a stored result, by their ids."""
    records = np.frombuffer(markers, dtype=_MARKER)
    return dict(zip(records["id"].tolist(), records["corners_px"].astype(np.float64), strict=True))


def points_documents(points: bytes) -> list[dict[str, Any]]:
    """Return stored points as the API shows them: every point found, rejected ones too."""
    names = _POINT.names or ()
    documents = []
    for record in np.frombuffer(points, dtype=_POINT).tolist():
        document = dict(zip(names, record, strict=True))
        if document["used"] == _UNKNOWN:
            document.update(residual_u_px=None, residual_v_px=None, used=None)
        else:
            document["used"] = document["used"] == 1
        documents.append(document)
    return documents
