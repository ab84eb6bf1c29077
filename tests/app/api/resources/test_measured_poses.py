"""Poses of another instrument: stored whole or not at all, once however often they come, refused by field."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from core.geometry.se3 import so3_exp
from tests.support.service.service import Api, ApiMaker, assert_problem

TURN = so3_exp(np.array([0.3, -0.2, 0.9]))
SIGMA = np.diag([0.01, 0.01, 0.02, 1e-5, 1e-5, 2e-5]) ** 2


@pytest.fixture(scope="module")
def api(open_api: ApiMaker) -> Iterator[Api]:
    """One application for all tests here: none counts what is stored."""
    with open_api() as running:
        yield running


def reading(pose_id: str = "P1", cycle: int | None = 1, **changes: Any) -> dict[str, Any]:
    return {
        "pose_id": pose_id,
        "cycle": cycle,
        "joint_angles_deg": [1.0, 2.0, 3.0],
        "position_mm": [100.0, -20.5, 3.25],
        "rotation": TURN.tolist(),
        "covariance": SIGMA.tolist(),
        **changes,
    }


def url(session: str) -> str:
    return f"/v1/sessions/{session}/measured-poses"


def post(api: Any, session: str, *readings: dict[str, Any], **options: Any) -> Any:
    return api.client.post(url(session), json=list(readings), **options)


def stored(api: Any, session: str, **query: Any) -> list[dict[str, Any]]:
    response = api.client.get(url(session), params=query)
    assert response.status_code == 200, response.text
    items: list[dict[str, Any]] = response.json()["items"]
    return items


def test_what_is_sent_is_stored_and_listed_page_by_page(any_api: Any) -> None:
    session = any_api.make_session()
    sent = [
        reading("P1", 1),
        reading("P1", 2, position_mm=[1, 2, 3]),
        reading("P2", None, rotation=None, covariance=None, joint_angles_deg=None),
        {"pose_id": "P3", "position_mm": [0.0, 0.0, 0.0]},
    ]
    response = post(any_api, session, *sent)
    assert response.status_code == 200, response.text
    answered = response.json()
    assert answered["next_cursor"] is None
    assert answered["items"] == stored(any_api, session)
    nothing = dict.fromkeys(("cycle", "joint_angles_deg", "rotation", "covariance"))
    assert [{k: v for k, v in item.items() if k != "id"} for item in answered["items"]] == [
        *sent[:3],
        {**sent[3], **nothing},
    ]
    first = any_api.client.get(url(session), params={"limit": 3}).json()
    second = any_api.client.get(url(session), params={"limit": 3, "cursor": first["next_cursor"]}).json()
    assert [*first["items"], *second["items"]] == answered["items"]
    assert (len(second["items"]), second["next_cursor"]) == (1, None)
    assert [item["cycle"] for item in stored(any_api, session, pose_id="P1")] == [1, 2]
    assert stored(any_api, session, pose_id="P9") == []
    # The poses they name exist from now on, with everything unknown; there are no measurements.
    poses = any_api.client.get(f"/v1/sessions/{session}/poses").json()["items"]
    assert [(pose["pose_id"], pose["joint_angles_deg"]) for pose in poses] == [
        ("P1", None),
        ("P2", None),
        ("P3", None),
    ]
    assert sum(any_api.client.get(f"/v1/sessions/{session}").json()["counts"].values()) == 0


def test_sending_again_stores_nothing_and_another_content_is_refused(any_api: Any) -> None:
    session = any_api.make_session()
    sent = [reading("P1", 1), reading("P1", None), reading("P1", None, position_mm=[1.0, 2.0, -0.0])]
    first = post(any_api, session, *sent).json()
    again = post(any_api, session, *sent)
    assert (again.status_code, again.json()) == (200, first)
    # Written otherwise, it is the same reading.
    assert (
        post(any_api, session, reading("P1", None, position_mm=[1, 2, 0])).json()["items"][0]["id"]
        == (first["items"][2]["id"])
    )
    # One more among known ones: the known keep their ids.
    more = post(any_api, session, sent[1], reading("P1", 2)).json()["items"]
    assert more[0]["id"] == first["items"][1]["id"]
    assert len(stored(any_api, session)) == 4

    changed = [reading("P2", 1), reading("P1", 1, position_mm=[9.0, 9.0, 9.0])]
    problem = assert_problem(post(any_api, session, *changed), 409, "measured_pose_conflict")
    assert [error["field"] for error in problem["errors"]] == ["1.cycle"]
    assert "cycle" in problem["advice"]
    assert len(stored(any_api, session)) == 4  # all or nothing
    other = any_api.make_session()
    assert post(any_api, other, *changed).status_code == 200


def test_a_session_takes_its_readings_with_it(any_api: Any) -> None:
    session, other = any_api.make_session(), any_api.make_session()
    for one in (session, other):
        assert post(any_api, one, reading()).status_code == 200
    assert any_api.client.delete(f"/v1/sessions/{session}").status_code == 204
    assert_problem(any_api.client.get(url(session)), 404, "session_not_found")
    assert len(stored(any_api, other)) == 1


def scaled(values: Any, factor: float) -> Any:
    return (factor * np.array(values)).tolist()


def with_entry(matrix: Any, row: int, column: int, value: float) -> Any:
    changed = copy.deepcopy(matrix)
    changed[row][column] = value
    return changed


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"pose_id": ".P"}, "1.pose_id"),
        ({"pose_id": None}, "1.pose_id"),
        ({"cycle": 0}, "1.cycle"),
        ({"cycle": "1"}, "1.cycle"),
        ({"position_mm": None}, "1.position_mm"),
        ({"position_mm": [1.0, 2.0]}, "1.position_mm"),
        ({"position_mm": [1.0, 2.0, "3"]}, "1.position_mm.2"),
        ({"position_mm": [1.0, 2.0, 1e300]}, "1.position_mm.2"),
        ({"joint_angles_deg": []}, "1.joint_angles_deg"),
        ({"rotation": [1.0, 0.0, 0.0]}, "1.rotation.0"),
        ({"rotation": np.eye(4).tolist()}, "1.rotation"),
        ({"rotation": scaled(TURN, 1.001)}, "1.rotation"),
        ({"rotation": np.diag([1.0, 1.0, -1.0]).tolist()}, "1.rotation"),
        ({"rotation": np.round(TURN, 3).tolist()}, "1.rotation"),
        ({"covariance": np.eye(3).tolist()}, "1.covariance"),
        ({"covariance": with_entry(SIGMA.tolist(), 0, 1, 5e-5)}, "1.covariance"),
        ({"covariance": scaled(SIGMA, -1.0)}, "1.covariance"),
        ({"covariance": (SIGMA + 1.0 - np.eye(6)).tolist()}, "1.covariance"),
        ({"covariance": with_entry(SIGMA.tolist(), 0, 1, 1e300)}, "1.covariance.0.1"),
        ({"rotations": TURN.tolist()}, "1.rotations"),
        ({"id": "mpo_mine"}, "1.id"),
    ],
)
def test_a_wrong_field_is_named_and_nothing_is_stored(api: Any, change: dict[str, Any], field: str) -> None:
    session = api.make_session()
    problem = assert_problem(post(api, session, reading("P1", 1), {**reading("P2", 1), **change}), 422)
    assert problem["code"] in ("invalid_request", "invalid_matrix")
    assert [error["field"] for error in problem["errors"] if error["field"].startswith(field)], problem
    assert stored(api, session) == []


def test_matrices_as_people_write_them_are_taken(api: Any) -> None:
    """Six decimals of a rotation, four digits of a full covariance, a semidefinite one, one of the position alone."""
    rng = np.random.default_rng(4)
    A = rng.normal(size=(6, 6)) * np.diag(SIGMA) ** 0.5
    full = np.array([[float(f"{v:.4g}") for v in row] for row in (A @ A.T + A.T @ A) / 2.0])
    position_alone = np.diag([1e-4, 1e-4, 1e-4, 0.0, 0.0, 0.0])
    rank_one = np.outer(A[0], A[0])
    sent = [
        reading("P1", None, rotation=np.round(TURN, 6).tolist(), covariance=matrix.tolist())
        for matrix in (full, position_alone, rank_one, np.zeros((6, 6)))
    ]
    assert post(api, api.make_session(), *sent).status_code == 200


def test_a_list_that_repeats_itself_is_refused(api: Any) -> None:
    session = api.make_session()
    for twice in (
        [reading("P1", 3), reading("P1", 3, position_mm=[0.0, 0.0, 1.0])],
        [reading("P1", None), reading("P1", None)],
    ):
        problem = assert_problem(post(api, session, reading("P0", 1), *twice), 422, "duplicate_measured_pose")
        assert [error["field"] for error in problem["errors"]] == ["2.pose_id"]
    assert stored(api, session) == []


def test_joints_are_as_many_as_the_robot_s(api: Any) -> None:
    joint = {"a_mm": 0.0, "alpha_deg": 0.0, "d_mm": 0.0}
    robot = api.client.post("/v1/robots", json={"name": "r", "joints": [joint] * 2}).json()["id"]
    session = api.make_session(robot_id=robot)
    problem = assert_problem(post(api, session, reading()), 422, "joint_angles_inconsistent")
    assert "2 joints" in problem["detail"]
    assert [error["field"] for error in problem["errors"]] == ["0.joint_angles_deg"]
    two, none = reading(joint_angles_deg=[1.0, 2.0]), reading("P2", joint_angles_deg=None)
    assert post(api, session, two, none).status_code == 200
    # Without a robot they are refused in the same way: within the list, and with what is stored.
    session = api.make_session()
    problem = assert_problem(post(api, session, two, reading("P3")), 422, "joint_angles_inconsistent")
    assert post(api, session, reading("P3")).status_code == 200
    assert_problem(post(api, session, two), 422, "joint_angles_inconsistent")


def test_scopes_addresses_and_sizes(api: Any) -> None:
    session = api.make_session()
    assert_problem(post(api, session, reading(), headers=api.key("read")), 403, "insufficient_scope")
    assert post(api, session, reading(), headers=api.key("upload")).status_code == 200
    assert api.client.get(url(session), headers=api.key("read")).status_code == 200
    assert_problem(post(api, "ses_nothing", reading()), 404, "session_not_found")
    assert_problem(api.client.get(url(session), params={"cursor": "x"}), 422, "invalid_cursor")
    assert_problem(api.client.get(url(session), params={"pose_id": "a b"}), 422)
    headers = {"Content-Type": "application/json"}
    large = b"[" + b" " * (16 * 1024 * 1024) + b"]"
    assert_problem(api.client.post(url(session), content=large, headers=headers), 413, "body_too_large")
    assert post(api, session).json() == {"items": [], "next_cursor": None, "warnings": []}


@pytest.mark.slow
def test_thousands_are_stored_in_one_list(api: Any) -> None:
    session = api.make_session()
    many = [reading(f"P{i}", 1, position_mm=[float(i), 0.0, 0.0], covariance=None) for i in range(5000)]
    assert post(api, session, *many).status_code == 200
    assert len(stored(api, session, limit=500)) == 500
    assert post(api, session, *many).status_code == 200
    assert len(api.client.get(f"/v1/sessions/{session}/poses", params={"limit": 500}).json()["items"]) == 500
