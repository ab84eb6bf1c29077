"""Targets by their form."""

from __future__ import annotations

import pytest

from app.client import ClientError
from app.client.resources.finding import _EXAMPLES, described_target


@pytest.mark.parametrize("kind", _EXAMPLES)
def test_the_example_of_each_kind_is_read(kind: str) -> None:
    fields = described_target(_EXAMPLES[kind])
    assert fields is not None
    assert fields["kind"] == kind
    assert fields["pitch_mm"] > 0.0


def test_a_form_has_every_field() -> None:
    assert described_target(
        "charuco:9x6:25.5,marker=18,dictionary=DICT_5X5_100,legacy_layout,u=0.01,print_kind=glass"
    ) == {
        "kind": "charuco",
        "columns": 9,
        "rows": 6,
        "pitch_mm": 25.5,
        "marker_mm": 18.0,
        "dictionary": "DICT_5X5_100",
        "legacy_layout": True,
        "pitch_standard_uncertainty_mm": 0.01,
        "print_kind": "glass",
    }


@pytest.mark.parametrize(
    "text", ["tgt_01m7y27rhc7t5mkfp8hz3c61jj", "A4 board", "Cell 7: board", "chessboard"]
)
def test_an_id_or_a_name_is_no_form(text: str) -> None:
    assert described_target(text) is None


@pytest.mark.parametrize(
    "text",
    [
        "chessboard:9x6",
        "chessboard:9:6:25",
        "aprilgrid:6x6:88,edge=80",
        "charuco:9x6:25,marker=x",
        "circles:",
    ],
)
def test_a_form_that_cannot_be_read_shows_the_right_one(text: str) -> None:
    with pytest.raises(ClientError, match="target_not_described") as caught:
        described_target(text)
    assert _EXAMPLES[text.partition(":")[0]] in (caught.value.advice or "")
