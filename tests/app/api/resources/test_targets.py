"""Targets: read as they were made, and refused where no print has or no search finds them."""

from __future__ import annotations

from typing import Any

import pytest


def test_a_target_is_read_as_it_was_made(any_api: Any) -> None:
    made = any_api.client.post(
        "/v1/targets",
        json={"name": "A3 board ø", "kind": "chessboard", "columns": 14, "rows": 10, "pitch_mm": 21.5},
    )
    assert made.status_code == 201
    document = made.json()
    assert {key: document[key] for key in ("name", "kind", "columns", "rows", "pitch_mm")} == {
        "name": "A3 board ø",
        "kind": "chessboard",
        "columns": 14,
        "rows": 10,
        "pitch_mm": 21.5,
    }
    assert document["legacy_layout"] is False
    assert (
        document["marker_mm"] is document["dictionary"] is document["pitch_standard_uncertainty_mm"] is None
    )
    assert document["created_at"].endswith("Z")
    assert made.headers["location"] == f"/v1/targets/{document['id']}"
    assert any_api.client.get(made.headers["location"]).json() == document


CHARUCO = {
    "name": "x",
    "kind": "charuco",
    "columns": 7,
    "rows": 5,
    "pitch_mm": 30.0,
    "marker_mm": 21.0,
    "dictionary": "DICT_APRILTAG_36h11",
}


def test_a_charuco_board_is_read_as_it_was_made(api: Any) -> None:
    made = api.client.post("/v1/targets", json={**CHARUCO, "legacy_layout": True})
    assert made.status_code == 201, made.text
    document = api.client.get(made.headers["location"]).json()
    assert {name: document[name] for name in CHARUCO} == CHARUCO
    assert document["legacy_layout"] is True


@pytest.mark.parametrize(
    ("changes", "words", "field"),
    [
        ({"dictionary": "DICT_9X9_50"}, "Unknown marker dictionary", "dictionary"),
        ({"dictionary": "6x6_250"}, "Unknown marker dictionary '6x6_250'", "dictionary"),
        ({"dictionary": "DetectorParameters"}, "Unknown marker dictionary", "dictionary"),
        ({"dictionary": None}, "dictionary is required for ChArUco boards", "dictionary"),
        ({"dictionary": "DICT_4X4_50", "columns": 14, "rows": 10}, "82 markers", "dictionary"),
        ({"marker_mm": None}, "marker_mm is required for ChArUco boards", "marker_mm"),
        ({"marker_mm": 1e-5}, "marker_mm", "marker_mm"),
        ({"marker_mm": 30.0}, "marker_mm", "marker_mm"),
        ({"columns": 2}, "2 x 5", "columns"),
        ({"rows": 2}, "7 x 2", "rows"),
    ],
)
def test_a_charuco_board_that_cannot_be_is_refused_with_advice(
    api: Any, changes: dict[str, Any], words: str, field: str
) -> None:
    response = api.client.post("/v1/targets", json={**CHARUCO, **changes})
    assert (response.status_code, response.json()["code"]) == (422, "invalid_target")
    assert words in response.json()["detail"]
    assert response.json()["advice"]
    assert [error["field"] for error in response.json()["errors"]] == [field]
    assert api.client.get("/v1/targets").json()["items"] == []


@pytest.mark.parametrize("pitch_mm", [0.0, -1.0, 1e-320, 9e-7, 1e10])
def test_a_pitch_that_no_print_has_is_refused(api: Any, pitch_mm: float) -> None:
    response = api.client.post("/v1/targets", json={**CHARUCO, "pitch_mm": pitch_mm})
    assert response.status_code == 422
    assert "pitch_mm" in [error["field"] for error in response.json()["errors"]]


def test_a_pitch_with_total_uncertainty_is_refused(api: Any) -> None:
    wanted = {"name": "x", "kind": "chessboard", "columns": 9, "rows": 6, "pitch_mm": 25.0}
    for uncertainty, status in ((25.0, 422), (24.9, 201)):
        response = api.client.post(
            "/v1/targets?accept_implausible=true",
            json={**wanted, "pitch_standard_uncertainty_mm": uncertainty},
        )
        assert response.status_code == status, response.text
        if status == 422:
            assert response.json()["code"] == "invalid_target"
            assert "pitch_standard_uncertainty_mm" in response.json()["detail"]
            (error,) = response.json()["errors"]
            assert error["field"] == "pitch_standard_uncertainty_mm"


@pytest.mark.parametrize("kind", ["chessboard", "circles", "asymmetric_circles"])
@pytest.mark.parametrize("field", ["columns", "rows"])
def test_a_grid_that_no_image_can_be_searched_for_is_refused(api: Any, kind: str, field: str) -> None:
    wanted = {"name": "x", "kind": kind, "columns": 5, "rows": 4, "pitch_mm": 25.0}
    response = api.client.post("/v1/targets", json=wanted | {field: 2})
    assert (response.status_code, response.json()["code"]) == (422, "invalid_target")
    assert [error["field"] for error in response.json()["errors"]] == [field]
    assert api.client.post("/v1/targets", json=wanted | {field: 3}).status_code == 201


@pytest.mark.parametrize(
    ("kind", "field", "value"),
    [
        ("chessboard", "marker_mm", 10.0),
        ("chessboard", "dictionary", "DICT_4X4_50"),
        ("chessboard", "legacy_layout", True),
        ("circles", "dictionary", "DICT_4X4_50"),
        ("asymmetric_circles", "legacy_layout", True),
        ("aprilgrid", "legacy_layout", True),
    ],
)
def test_what_a_kind_of_target_has_not_is_refused_by_name(
    api: Any, kind: str, field: str, value: object
) -> None:
    wanted = {"name": "x", "kind": kind, "columns": 5, "rows": 4, "pitch_mm": 25.0}
    if kind == "aprilgrid":
        wanted |= {"marker_mm": 20.0, "dictionary": "DICT_APRILTAG_36h11"}
    response = api.client.post("/v1/targets", json=wanted | {field: value})
    assert (response.status_code, response.json()["code"]) == (422, "invalid_target")
    assert [error["field"] for error in response.json()["errors"]] == [field]
    nothing: dict[str, Any] = {"pitch_standard_uncertainty_mm": None, "legacy_layout": False}
    if kind != "aprilgrid":
        nothing |= {"marker_mm": None, "dictionary": None}
    assert api.client.post("/v1/targets", json=wanted | nothing).status_code == 201


def test_the_diameter_of_dots_is_kept(api: Any) -> None:
    wanted = {"name": "x", "kind": "circles", "columns": 5, "rows": 4, "pitch_mm": 25.0, "marker_mm": 12.0}
    made = api.client.post("/v1/targets", json=wanted)
    assert (made.status_code, made.json()["marker_mm"]) == (201, 12.0)


@pytest.mark.parametrize(
    ("changes", "word", "field"),
    [
        ({}, "marker_mm is required for AprilGrids", "marker_mm"),
        ({"marker_mm": 30}, "less than its pitch_mm of 30, got 30", "marker_mm"),
        ({"marker_mm": 45}, "less than its pitch_mm of 30, got 45", "marker_mm"),
        ({"marker_mm": 29.5}, "gaps", "marker_mm"),
        ({"marker_mm": 2}, "gaps", "marker_mm"),
        ({"marker_mm": 24, "dictionary": "DICT_6X6_250"}, "36h11", "dictionary"),
        ({"marker_mm": 24, "dictionary": "tag36h11"}, "Unknown marker dictionary", "dictionary"),
        ({"marker_mm": 24, "dictionary": "DICT_9X9_50"}, "Unknown marker dictionary", "dictionary"),
        ({"marker_mm": 24, "columns": 30, "rows": 20}, "600 tags", "columns"),
        ({"marker_mm": 24, "columns": 20, "rows": 30}, "600 tags", "rows"),
    ],
)
def test_an_aprilgrid_that_cannot_be_printed_is_refused(
    api: Any, changes: dict[str, Any], word: str, field: str
) -> None:
    wanted = {"name": "x", "kind": "aprilgrid", "columns": 5, "rows": 7, "pitch_mm": 30}
    response = api.client.post("/v1/targets", json=wanted | changes)
    assert response.status_code == 422
    assert response.json()["code"] == "invalid_target"
    assert word in response.json()["detail"]
    assert response.json()["advice"]
    assert [error["field"] for error in response.json()["errors"]] == [field]
    assert api.client.get("/v1/targets").json()["items"] == []
    assert api.client.post("/v1/targets", json=wanted | {"marker_mm": 24}).status_code == 201
