"""From images of a ChArUco board to the tables, over HTTP: markers are found, stored, compared, and found anew."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from functools import cache
from typing import Any

import numpy as np
import pytest
import sqlalchemy as sa
from jaxtyping import UInt8

from app.records.codec import content_hash, decode_markers
from app.records.tables import Measurement, Result
from core.geometry.camera import Camera
from core.geometry.se3 import so3_exp, transform
from core.simulation import Scene, render
from core.targets.specification import TargetSpec
from tests.support.image.images import encode
from tests.support.sessions.stored_sessions import body

pytestmark = (
    pytest.mark.slow
)  # rendered scenes through a worker; test_comparison.py has the claims on stored points

FIELDS = {"kind": "charuco", "columns": 7, "rows": 5, "pitch_mm": 24.0, "marker_mm": 16.8}
BOARD = TargetSpec(**FIELDS, dictionary="DICT_5X5_100")  # type: ignore[arg-type]
CAMERA = Camera(860.0, 860.0, 383.5, 287.5, k1=-0.1, k2=0.05)
POSES, CYCLES = 3, 5
LONG_AGO = datetime(2026, 1, 31, tzinfo=UTC)


@cache
def without_noise(pose: int) -> UInt8[np.ndarray, "h w"]:
    axis = np.array([math.cos(2.1 * pose), math.sin(2.1 * pose), 0.0])
    R = so3_exp(math.radians(30.0) * axis) @ so3_exp(np.array([0.0, 0.0, 0.2 * pose - 0.1]))
    T = transform(R, np.array([0.0, 0.0, 260.0 + 20.0 * pose]) - R @ BOARD.points_target().mean(axis=0))
    return render(Scene(BOARD, CAMERA, T, 768, 576, noise_levels=0.0, seed=pose))


def photograph(pose: int, cycle: int) -> bytes:
    """What a robot that stands still sees in each cycle: the same but for the noise."""
    seen = without_noise(pose)
    noise = np.random.default_rng([pose, cycle]).normal(0.0, 3.0, seen.shape)
    return encode(".png", np.clip(np.rint(seen + noise), 0.0, 255.0).astype(np.uint8))


@pytest.fixture(scope="module")
def measured(computing_api: Any) -> tuple[str, list[dict[str, Any]]]:
    """A session of measured images: its id and its measurements."""
    api = computing_api
    target_id = api.make_target(**FIELDS, dictionary=BOARD.dictionary)
    session = api.make_session(target_id)
    ids = []
    for pose in range(POSES):
        for cycle in range(1, CYCLES + 1):
            answer = api.put_image(session, photograph(pose, cycle), f"P{pose + 1}", cycle=cycle)
            assert answer.status_code == 202, answer.text
            ids.append(answer.json()["id"])
    return session, [api.wait_for(measurement_id) for measurement_id in ids]


def rows(api: Any, session: str, table: str) -> dict[str, dict[str, Any]]:
    document = body(api.client.get(f"/v1/sessions/{session}/comparison"))
    return {row["method"]: row for row in document[table]}


def stored(api: Any, measurement_id: str) -> bytes | None:
    with api.installation.database.read() as records:
        markers: bytes | None = records.scalar(
            sa.select(Result.markers).where(Result.measurement_id == measurement_id)
        )
    return markers


def test_every_image_is_measured_and_its_markers_are_kept(
    computing_api: Any, measured: tuple[str, list[dict[str, Any]]]
) -> None:
    for measurement in measured[1]:
        assert measurement["status"] == "succeeded", measurement["failure"]
        assert measurement["calibration"]["reprojection"]["points"] == BOARD.size
        markers = stored(computing_api, measurement["id"])
        assert markers is not None
        assert sorted(decode_markers(markers)) == list(range(24))


def test_one_marker_repeats_many_times_worse_than_all_points_together(
    computing_api: Any, measured: tuple[str, list[dict[str, Any]]]
) -> None:
    session, _ = measured
    table = rows(computing_api, session, "repeatabilities")

    def rp(method: str) -> float:
        assert table[method]["failure"] is None
        assert [pose["cycles"] for pose in table[method]["poses"]] == [CYCLES] * POSES
        return float(np.mean([pose["repeatability"]["rp_l_mm"] for pose in table[method]["poses"]]))

    # at equal corner noise METHOD has 20; RP_l of five cycles knows its value to a third, the mean of three poses to .2
    assert rp("aruco_marker") > 10.0 * rp("pooled")
    assert rp("aruco_board") > rp("pooled")  # cornerSubPix on four corners a marker
    assert rp("zhang") == pytest.approx(rp("pooled"), rel=0.2)
    calibrated = rows(computing_api, session, "calibrations")
    for method in ("aruco_marker", "aruco_board"):
        row = calibrated[method]
        assert (row["camera_of"], row["calibrated"], row["failed"]) == ("pooled", POSES * CYCLES, 0)
        assert row["intrinsics"] == calibrated["pooled"]["intrinsics"]
        assert row["standard_deviation"] is None
    assert calibrated["pooled"]["intrinsics"]["fx_px"] == pytest.approx(CAMERA.fx_px, rel=5e-3)


def test_given_intrinsics_are_the_markers_camera(
    computing_api: Any, measured: tuple[str, list[dict[str, Any]]]
) -> None:
    session, _ = measured
    before = computing_api.client.get(f"/v1/sessions/{session}/comparison").headers["etag"]
    given = {"fx_px": 860.0, "fy_px": 860.0, "cx_px": 383.5, "cy_px": 287.5, "k1": -0.1, "k2": 0.05}
    patched = computing_api.client.patch(f"/v1/sessions/{session}", json={"intrinsics": given})
    assert patched.status_code == 200, patched.text
    try:
        assert computing_api.client.get(f"/v1/sessions/{session}/comparison").headers["etag"] != before
        row = rows(computing_api, session, "calibrations")["aruco_board"]
        assert row["camera_of"] == "session"
        assert row["intrinsics"]["fx_px"] == 860.0
    finally:
        computing_api.client.patch(f"/v1/sessions/{session}", json={"intrinsics": None})


def test_what_was_measured_before_markers_were_kept_says_so_until_it_is_retried(
    computing_api: Any, measured: tuple[str, list[dict[str, Any]]]
) -> None:
    session, measurements = measured
    old = measurements[0]["id"]
    kept = stored(computing_api, old)
    before = computing_api.client.get(f"/v1/sessions/{session}/comparison").headers["etag"]
    with computing_api.installation.database.write() as records:
        points = records.scalar(sa.select(Result.points).where(Result.measurement_id == old))
        without = {"markers": None, "content_sha256": content_hash(points, None)}
        records.execute(sa.update(Result).where(Result.measurement_id == old).values(**without))
        records.execute(sa.update(Measurement).where(Measurement.id == old).values(finished_at=LONG_AGO))
    for method in ("aruco_marker", "aruco_board"):
        row = rows(computing_api, session, "calibrations")[method]
        assert (row["calibrated"], row["failed"], row["failure"]) == (POSES * CYCLES - 1, 1, None)
        (failure,) = row["failures"]
        assert (failure["code"], failure["measurement_ids"]) == ("markers_not_stored", [old])
        assert "Retry" in failure["advice"]
    assert computing_api.client.get(f"/v1/sessions/{session}/comparison").headers["etag"] != before
    assert computing_api.client.post(f"/v1/measurements/{old}/retry").status_code == 202
    computing_api.wait_for(old)
    assert stored(computing_api, old) == kept
    assert computing_api.client.get(f"/v1/sessions/{session}/comparison").headers["etag"] == before


def test_an_image_without_the_board_fails_in_words(
    computing_api: Any, measured: tuple[str, list[dict[str, Any]]]
) -> None:
    target_id = computing_api.make_target(**FIELDS, dictionary="DICT_4X4_100")
    session = computing_api.make_session(target_id)
    answer = computing_api.put_image(session, photograph(0, 1))
    found = computing_api.wait_for(answer.json()["id"])
    assert (found["status"], found["failure"]["code"]) == ("failed", "target_not_found")
    assert "dictionary" in found["failure"]["advice"]
    assert stored(computing_api, found["id"]) is None
