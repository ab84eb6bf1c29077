"""Analyses of a session whose every image shows two perpendicular grids and names neither: rendered, searched, tied."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from core import TargetSpec
from core.geometry.se3 import so3_log
from tests.support.sessions.stored_sessions import body
from tests.support.simulation.room_corner import CAMERA, Corner

AHEAD = TargetSpec("chessboard", 8, 5, 18.0)
RIGHT = TargetSpec("charuco", 6, 5, 22.0, 16.0, "DICT_5X5_100")
VIEWS = {
    "P1": {"turn": 0.1},
    "P2": {"turn": 0.8, "lift_mm": 60.0},
    "P3": {"turn": -0.6, "lift_mm": -50.0, "near_mm": 40.0},
}


@pytest.fixture(scope="module")
def session(computing_api: Any) -> tuple[str, list[str]]:
    """Three poses, twice each: the session and its targets."""
    corner = Corner(AHEAD, RIGHT)
    targets = [computing_api.make_target(**dataclasses.asdict(spec)) for spec in (AHEAD, RIGHT)]
    session_id = computing_api.make_session(*targets)
    accepted = [
        computing_api.put_image(
            session_id, corner.image(corner.view(**view), seed=10 * cycle + k), pose_id, cycle=cycle
        )
        for cycle in (1, 2)
        for k, (pose_id, view) in enumerate(VIEWS.items())
    ]
    for response in accepted:
        assert computing_api.wait_for(response.json()["id"])["status"] == "succeeded"
    return session_id, targets


@pytest.mark.slow
def test_the_grids_are_tied_by_the_images_that_show_both(computing_api: Any, session: Any) -> None:
    session_id, targets = session
    found = body(computing_api.client.get(f"/v1/sessions/{session_id}/intrinsics"))
    (group,) = found["groups"]
    assert group["image_count"] == 2 * 2 * len(VIEWS)
    (between,) = found["target_transforms"]
    assert (between["from_target_id"], between["to_target_id"], between["image_count"]) == (*targets, 6)
    T, said = Corner(AHEAD, RIGHT).T_ahead_right, np.array(between["T_from_to"])
    # Five standard uncertainties: one session of one seed, which must not fail by mere chance.
    stated = 5.0 * np.sqrt(np.diag(np.array(between["covariance"])))
    assert np.all(np.abs(said[:3, 3] - T[:3, 3]) < stated[:3])
    assert np.all(np.abs(so3_log(said[:3, :3] @ T[:3, :3].T)) < stated[3:])
    assert np.linalg.norm(said[:3, 3] - T[:3, 3]) < 1.0
    assert float(said[:3, 2] @ [0.0, 0.0, 1.0]) == pytest.approx(0.0, abs=math.radians(0.2))
    assert group["intrinsics"]["fx_px"] == pytest.approx(CAMERA.fx_px, rel=0.005)


def test_every_pose_is_one_of_one_target_and_nothing_is_dropped(computing_api: Any, session: Any) -> None:
    session_id, _ = session
    table = body(computing_api.client.get(f"/v1/sessions/{session_id}/repeatability"))
    assert [(pose["pose_id"], pose["cycles"]) for pose in table["poses"]] == [(pose, 2) for pose in VIEWS]
    for pose in table["poses"]:
        assert len(pose["measurement_ids"]) == 2
        assert [left["code"] for left in pose["excluded"]] == ["images_of_other_target"] * 2
        assert pose["repeatability"]["rp_l_mm"] < 0.2
    compared = body(computing_api.client.get(f"/v1/sessions/{session_id}/comparison"))
    assert compared["image_count"] == 2 * 2 * len(VIEWS)


@pytest.mark.slow
def test_an_image_of_neither_is_named_in_every_table(
    computing_api: Any, session: Any, grey_png: bytes
) -> None:
    session_id, _ = session
    nothing = computing_api.put_image(session_id, grey_png, "P4").json()["id"]
    assert computing_api.wait_for(nothing)["failure"]["code"] == "target_not_found"
    table = body(computing_api.client.get(f"/v1/sessions/{session_id}/repeatability"))
    (row,) = (pose for pose in table["poses"] if pose["pose_id"] == "P4")
    assert (row["cycles"], [left["measurement_id"] for left in row["excluded"]]) == (0, [nothing])
    for analysis in ("intrinsics", "comparison"):
        body(computing_api.client.get(f"/v1/sessions/{session_id}/{analysis}"))
    for plot in ("repeatability/scatter.svg", "intrinsics/residuals.svg"):
        assert computing_api.client.get(f"/v1/sessions/{session_id}/{plot}").status_code == 200


ANALYSES = ("intrinsics", "repeatability", "comparison")


@pytest.mark.slow
def test_the_order_of_named_and_unnamed_uploads_changes_nothing(computing_api: Any, session: Any) -> None:
    _, targets = session
    corner = Corner(AHEAD, RIGHT)
    images = {pose: corner.image(corner.view(**view), seed=k) for k, (pose, view) in enumerate(VIEWS.items())}
    summaries = []
    for order in ((None, *targets), (*targets, None), (targets[1], None, targets[0])):
        session_id = computing_api.make_session(*targets)
        for target_id in order:
            query = {} if target_id is None else {"target_id": target_id}
            for response in [
                computing_api.put_image(session_id, data, pose, **query) for pose, data in images.items()
            ]:
                computing_api.wait_for(response.json()["id"])
        found = [body(computing_api.client.get(f"/v1/sessions/{session_id}/{name}")) for name in ANALYSES]
        summaries.append(
            [
                (f["inputs_sha256"], [w["code"] for w in f["warnings"]], f.get("image_count"), f["pending"])
                for f in found
            ]
        )
        assert [len(pose["excluded"]) for pose in found[1]["poses"]] == [1] * len(
            VIEWS
        )  # of the other target
        assert all(code != "images_excluded" for _, codes, _, _ in summaries[-1] for code in codes)
    assert summaries[0] == summaries[1] == summaries[2]
