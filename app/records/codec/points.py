"""Grid points and markers as bytes: one `_POINT` record per grid point, one `_MARKER` record per marker seen, ascending
by id, both little endian."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from app.records.codec.remarks import decode_advisories, decode_quality
from core.calibration.view_stack import ViewStack
from core.targets.specification import GridPoints, Origin, TargetSpec

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
_ORIGINS: dict[str | None, Origin] = {
    None: "known",
    "known": "known",
    "turned": "turned",
    "unknown": "unknown",
}
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


def decode_points(
    points: bytes,
    warnings: list[dict[str, Any]],
    target: TargetSpec,
    width_px: int,
    height_px: int,
    *,
    origin: str | None = None,
    capture_quality: dict[str, Any] | None = None,
) -> GridPoints:
    """Return the grid points of a stored result, but for their markers.

    `origin` is null in results of the time before it was kept, when every grid's was known or one of its turns'.
    """
    records = np.frombuffer(points, dtype=_POINT)
    return GridPoints(
        target=target,
        image_width_px=width_px,
        image_height_px=height_px,
        column=records["column"].astype(np.intp),
        row=records["row"].astype(np.intp),
        points_px=np.stack([records["u_px"], records["v_px"]], axis=1),
        standard_uncertainty_px=records["standard_uncertainty_px"].copy(),
        warnings=decode_advisories(warnings),
        origin=_ORIGINS[origin],
        capture_quality=decode_quality(capture_quality) if capture_quality is not None else None,
    )


def decode_residuals(points: bytes) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """Return the residuals (px) of stored points that a fit looked at, and which of them it used."""
    records = np.frombuffer(points, dtype=_POINT)
    return np.stack([records["residual_u_px"], records["residual_v_px"]], axis=1), records["used"] == 1


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


def end_points(points: Sequence[bytes]) -> tuple[Int[np.ndarray, "m 2 2"], Float[np.ndarray, "m 2 2"]]:
    """Return column and row, and u and v (px), of the first and the last point of stored results that have points."""
    size = _POINT.itemsize
    records = np.frombuffer(b"".join(end for p in points for end in (p[:size], p[-size:])), dtype=_POINT)
    cells = np.stack([records["column"], records["row"]], axis=1).astype(np.intp)
    return cells.reshape(-1, 2, 2), np.stack([records["u_px"], records["v_px"]], axis=1).reshape(-1, 2, 2)


def rename_points(points: bytes, column: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"]) -> bytes:
    """Return stored points under other names, row by row as a detector lists them."""
    records = np.frombuffer(points, dtype=_POINT).copy()
    records["column"], records["row"] = column, row
    return records[np.lexsort((column, row))].tobytes()


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
