"""Targets by the id that is printed on their sheets."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import pytest

from app.client import ClientError, ServiceClient, find_or_make_session, find_or_make_target
from app.client.resources.sheets import sheet_matcher
from app.printing import sheet_id_of
from core import TargetSpec
from core.targets import marker_dictionary
from tests.support.service.service import Api, ApiMaker

DICTIONARIES = [
    f"DICT_{kind}"
    for kind in (
        *(f"{size}X{size}_{count}" for size in (4, 5, 6, 7) for count in (50, 100, 250, 1000)),
        *(
            "APRILTAG_16h5",
            "APRILTAG_16H5",
            "APRILTAG_25h9",
            "APRILTAG_36h10",
            "APRILTAG_36H11",
            "ARUCO_ORIGINAL",
        ),
        *("ARUCO_MIP_36h12", "ARUCO_MIP_36H12"),
    )
]


def stored(target: TargetSpec) -> dict[str, Any]:
    """Return a target as the service has it, after its numbers went through JSON."""
    return asdict(target)


def is_on(target: TargetSpec, **extras: Any) -> bool:
    matcher = sheet_matcher(f"sheet:{sheet_id_of(target, **extras)}")
    assert matcher is not None
    return matcher(stored(target))


@pytest.mark.parametrize("dictionary", DICTIONARIES)
def test_the_id_of_every_board_is_that_of_its_drawing(dictionary: str) -> None:
    available = len(marker_dictionary(TargetSpec("charuco", 3, 3, 20.0, 15.0, dictionary)).bytesList)
    boards = [
        TargetSpec("charuco", columns, rows, 20.0, 15, dictionary, legacy)
        for columns, rows in ((3, 3), (9, 6), (9, 7), (9, 9), (19, 9), (20, 11), (40, 23))
        if (columns + 1) * (rows + 1) // 2 <= available
        for legacy in (False, True)
    ]
    assert boards
    assert all(is_on(board) for board in boards)
    others = [board for board in boards if board.columns != 3]
    assert not any(
        sheet_matcher(f"sheet:{sheet_id_of(boards[0])}")(stored(other))  # type: ignore[misc]
        for other in others
    )


def test_the_id_of_every_other_kind_is_that_of_its_drawing() -> None:
    for target in (
        TargetSpec("chessboard", 9, 6, 25),
        TargetSpec("chessboard", 9, 6, 25.4, pitch_standard_uncertainty_mm=0.1, print_kind="glass"),
        TargetSpec("aprilgrid", 6, 6, 88.0, 80.0),
        TargetSpec("aprilgrid", 6, 6, 88.0, 80.0, "DICT_APRILTAG_36h11"),
    ):
        assert is_on(target)
    assert is_on(TargetSpec("chessboard", 9, 6, 25.0), marks=True)
    for kind, usual in (("circles", 10.0), ("asymmetric_circles", 10.0 * math.sqrt(2.0))):
        for marker_mm in (None, usual, 8, 8.5):
            for origin_dot in (1.0, 1.3, 1.35, 2.4):
                assert is_on(TargetSpec(kind, 7, 5, 20.0, marker_mm), origin_dot=origin_dot)


@pytest.mark.parametrize(
    "text", ["sheet:", "sheet:12", "sheet:gp-5d49aa3g", "sheet:tgt_01m7y27rhc7t5mkfp8hz3c61jj"]
)
def test_what_is_no_id_of_a_sheet_shows_the_right_form(text: str) -> None:
    with pytest.raises(ClientError, match="target_not_described") as caught:
        sheet_matcher(text)
    assert "sheet:gp-5d49aa3e" in (caught.value.advice or "")


def test_a_target_of_the_service_is_found_by_its_sheet(serve_api: ApiMaker) -> None:
    with serve_api() as api:
        check_sheets(api)


def check_sheets(api: Api) -> None:
    url = str(api.client.base_url)
    key = api.client.headers["authorization"].removeprefix("Bearer ")
    board = TargetSpec("charuco", 9, 6, 25.0, 18.0, "DICT_5X5_100")
    sheet = f"sheet:{sheet_id_of(board)}"
    with ServiceClient(url, key) as client:
        with pytest.raises(ClientError, match="target_not_found") as absent:
            find_or_make_target(client, sheet)
        assert "charuco:9x6:25,marker=18,dictionary=DICT_5X5_100" in (absent.value.advice or "")
        with pytest.raises(ClientError, match="invalid_target") as refused:
            find_or_make_target(client, "charuco:9x6:25")
        assert "dictionary=DICT_5X5_100" in (refused.value.advice or "")
        assert str(refused.value).count("is required") == 1
        form = "charuco:9x6:25,marker=18,dictionary=DICT_5X5_250"  # the same markers
        target_id = find_or_make_target(client, form)
        for written in (sheet, sheet.replace("gp-", ""), f"sheet:{sheet_id_of(board).upper()}"):
            assert find_or_make_target(client, written) == target_id
        made = find_or_make_session(client, "cell", sheet)
        assert made[1] == target_id
        assert find_or_make_session(client, "cell", sheet) == made
        find_or_make_target(client, f"{form},u=0.01")
        with pytest.raises(ClientError, match="target_ambiguous"):
            find_or_make_target(client, sheet)
        assert find_or_make_session(client, "cell", sheet) == made  # the session has one of the two
