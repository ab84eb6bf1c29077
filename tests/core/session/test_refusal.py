"""Advice where no image serves follows the commonest reason."""

from __future__ import annotations

import pytest

from core.session.estimation.refusal import refusal_of_all


@pytest.mark.parametrize(
    ("reasons", "words"),
    [
        ({"target_mismatch": 13}, "columns and rows"),
        ({"target_not_in_session": 3, "target_not_found": 1}, "target_ids"),
        ({"target_not_in_session": 1, "target_not_found": 3}, "Show the whole grid"),
        ({"excluded_by_user": 4}, "gridpose measurements include"),
        ({"target_mirrored": 2}, "mirroring"),
        ({"undecodable_image": 2, "no_points": 1}, "damaged"),
        ({"no_points": 2}, "overlays"),
        ({}, "overlays"),
    ],
)
def test_advice_is_of_the_commonest_reason(reasons: dict[str, int], words: str) -> None:
    refused = refusal_of_all(20, reasons)
    assert refused.code == "no_usable_images"
    assert refused.advice is not None
    assert words in refused.advice
    assert all(f"{code} ({count})" in refused.detail for code, count in reasons.items())
