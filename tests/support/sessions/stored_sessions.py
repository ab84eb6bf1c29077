"""Sessions with stored grid points of known truth, put into the database as a worker would have."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import os
import random
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest
from jaxtyping import Float

from app.records.codec import encode_calibration, encode_refused
from app.records.ids import new_id
from app.records.outcome import Provenance
from app.records.tables import Measurement, Result
from app.services.poses import get_or_create_pose
from core import Camera, GridposeError, calibrate_points
from core.geometry.camera import project
from core.geometry.roll_pitch_yaw import rotation_to_rpy
from core.geometry.se3 import invert, so3_exp, transform, transform_points
from core.targets.specification import GridPoints, TargetSpec
from tests.support.simulation.simulated_views import draw_pose

WIDTH, HEIGHT = 1224, 1024
CAMERA = Camera(1160.0, 1160.3, 605.0, 515.0, -0.1, 0.05, 1e-4, -2e-4)
BOARD = TargetSpec("chessboard", 9, 6, 12.0)
MEASURED_BOARD = dataclasses.replace(BOARD, pitch_standard_uncertainty_mm=1e-4)
"""The same with a stated scale, so that absolute figures have an uncertainty."""


@dataclass(frozen=True)
class Shot:
    """One image before it is stored: what was seen, and where the camera truly was."""

    pose_id: str
    cycle: int | None
    points: GridPoints | None
    T_target_camera: Any
    fields: dict[str, Any] = field(default_factory=dict)
    failure: str | None = None

    @property
    def sha256(self) -> str:
        seen = self.points.points_px.tobytes() if self.points is not None else b"nothing"
        return hashlib.sha256(seen + repr((self.pose_id, self.cycle)).encode()).hexdigest()


def draw_board_pose(
    rng: np.random.Generator, tilt_deg: float, board: TargetSpec = BOARD
) -> Float[np.ndarray, "4 4"]:
    """Draw a pose of a board before `CAMERA`, tilted by so much."""
    return draw_pose(rng, board, CAMERA, WIDTH, math.radians(tilt_deg))


def look(
    rng: np.random.Generator,
    T_camera_target: Any,
    *,
    board: TargetSpec = BOARD,
    camera: Camera = CAMERA,
    sigma_px: float = 0.02,
    size: tuple[int, int] = (WIDTH, HEIGHT),
    bow_mm: float = 0.0,
) -> GridPoints:
    """What a detector reports of a board, which may be bowed along its x axis."""
    printed = board.points_target()
    along = printed[:, 0] / printed[:, 0].max()
    printed[:, 2] += 4.0 * bow_mm * along * (1.0 - along)
    exact = project(transform_points(T_camera_target, printed), camera)
    row, column = (a.ravel() for a in np.mgrid[0 : board.rows, 0 : board.columns])
    noisy = exact + rng.normal(0.0, sigma_px, exact.shape)
    return GridPoints(board, *size, column, row, noisy, np.full(len(exact), sigma_px))


def shoot(
    seed: int = 1,
    *,
    poses: int = 5,
    cycles: int = 12,
    repeatability_mm: float = 0.05,
    tilt_deg: float = 30.0,
    **looks: Any,
) -> list[Shot]:
    """A session: every pose visited in every cycle, by a robot whose positions scatter."""
    rng = np.random.default_rng(seed)
    board = looks.get("board", BOARD)
    commanded = [draw_board_pose(rng, tilt_deg, board) for _ in range(poses)]
    shots = []
    for cycle in range(1, cycles + 1):
        for index, T_camera_target in enumerate(commanded):
            d, w = rng.normal(0.0, repeatability_mm, 3), rng.normal(0.0, repeatability_mm * 1e-3, 3)
            T_target_camera = invert(T_camera_target)
            true = transform(so3_exp(w) @ T_target_camera[:3, :3], T_target_camera[:3, 3] + d)
            shots.append(Shot(f"P{index + 1}", cycle, look(rng, invert(true), **looks), true))
    return shots


def commanded_pose(T_base_flange: Any) -> dict[str, Any]:
    """Return the fields of a commanded pose."""
    roll, pitch, yaw = np.degrees(rotation_to_rpy(T_base_flange[:3, :3])).tolist()
    return {
        "position_mm": T_base_flange[:3, 3].tolist(),
        "roll_deg": roll,
        "pitch_deg": pitch,
        "yaw_deg": yaw,
    }


def put_pose(api: Any, session_id: str, pose_id: str, commanded: dict[str, Any]) -> None:
    """Store a commanded pose."""
    response = api.client.put(f"/v1/sessions/{session_id}/poses/{pose_id}", json=commanded)
    assert response.status_code == 200, response.text


def codes(document: dict[str, Any]) -> list[str]:
    """Return the codes of a document's warnings, in their order."""
    return [warning["code"] for warning in document["warnings"]]


Store = Callable[..., list[str]]


def store_shots(api: Any, session_id: str, shots: Sequence[Shot], target_id: str | None = None) -> list[str]:
    """Store shots as finished measurements, as a worker would have, and return their ids."""
    session = api.client.get(f"/v1/sessions/{session_id}").json()
    ids = []
    with api.installation.database.write() as records:
        for shot in shots:
            get_or_create_pose(records, session_id, shot.pose_id)
            columns, failure = _computed(shot)
            measurement = Measurement(
                **{
                    "id": new_id("mea"),
                    "session_id": session_id,
                    "pose_id": shot.pose_id,
                    "target_id": target_id or session["target_ids"][0],
                    "cycle": shot.cycle,
                    "focus_group": "default",
                    "received_at": datetime.now(UTC),
                    "sha256": shot.sha256,
                    "bytes": 1,
                    "image_format": "png",
                    "image_width_px": shot.points.image_width_px if shot.points else WIDTH,
                    "image_height_px": shot.points.image_height_px if shot.points else HEIGHT,
                    "status": "failed" if failure else "succeeded",
                    "attempts": 1,
                    "failure_code": failure[0] if failure else None,
                    "failure_detail": failure[1] if failure else None,
                    **shot.fields,
                }
            )
            records.add(measurement)
            records.flush()
            if columns is not None and measurement.status in ("succeeded", "failed"):
                records.add(Result(measurement_id=measurement.id, **columns))
            ids.append(measurement.id)
    return ids


def _computed(shot: Shot) -> tuple[dict[str, Any] | None, tuple[str, str] | None]:
    provenance = Provenance("0.1.0", shot.sha256, {})
    if shot.points is None:
        return encode_refused(None, provenance), (shot.failure or "target_not_found", "No grid was found.")
    try:
        return encode_calibration(calibrate_points(shot.points), provenance), None
    except GridposeError as error:
        return encode_refused(shot.points, provenance), (error.code, error.detail)


def with_fields(shots: Sequence[Shot], **fields: Any) -> list[Shot]:
    return [dataclasses.replace(shot, fields={**shot.fields, **fields}) for shot in shots]


def board_fields(board: TargetSpec) -> dict[str, Any]:
    fields: dict[str, Any] = {"columns": board.columns, "rows": board.rows, "pitch_mm": board.pitch_mm}
    if board.pitch_standard_uncertainty_mm is not None:
        fields["pitch_standard_uncertainty_mm"] = board.pitch_standard_uncertainty_mm
    return fields


_OF_SUBJECT = re.compile(r"(tgt|rob)_[0-9a-z]{26}")
"""Ids of targets and robots, of which each session of a test has its own."""


def same_but_for_ids(first: str, ids: Sequence[str], second: str, others: Sequence[str]) -> bool:
    """Return whether two documents are the same text once the ids in each are replaced by their places."""
    first, second = (_OF_SUBJECT.sub(r"\1", text) for text in (first, second))
    for place, (one, other) in enumerate(zip(ids, others, strict=True)):
        first, second = first.replace(one, f"<{place}>"), second.replace(other, f"<{place}>")
    return first == second


def assert_order_is_irrelevant(
    api: Any, store: Store, shots: Sequence[Shot], get: Callable[[str], Any]
) -> tuple[dict[str, Any], list[str]]:
    """Store shots in two sessions, once shuffled, and compare what `get` answers of each; return the first session's
    document and its measurements.
    """
    order = list(range(len(shots)))
    random.Random(3).shuffle(order)
    session, other = new_session(api), new_session(api)
    ids = store(api, session, shots)
    others = store(api, other, [shots[place] for place in order])
    matched = [others[order.index(i)] for i in range(len(shots))]
    first, second = get(session), get(other)
    document = body(first)
    assert document["inputs_sha256"] == body(second)["inputs_sha256"]
    assert same_but_for_ids(first.text, [session, *ids], second.text, [other, *matched])
    return document, ids


def body(response: Any) -> dict[str, Any]:
    assert response.status_code == 200, response.text
    document: dict[str, Any] = json.loads(response.text, parse_constant=pytest.fail)
    return document


def problem(response: Any, status: int, code: str) -> dict[str, Any]:
    document: dict[str, Any] = response.json()
    assert (response.status_code, document["code"]) == (status, code), response.text
    assert response.headers["content-type"] == "application/problem+json"
    return document


def new_session(api: Any, *boards: TargetSpec, **fields: Any) -> str:
    """A session that looks at these boards."""
    targets = [api.make_target(**board_fields(board)) for board in boards or (BOARD,)]
    return str(api.make_session(*targets, **fields))


def die(*_arguments: Any) -> None:
    """End the process this runs in, as a crash would."""
    os._exit(9)
