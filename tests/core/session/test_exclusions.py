"""What is said of images that are not in the figures: how many of how many, why, and only advice that helps."""

from __future__ import annotations

import re

import pytest

from core.session.estimate import ExcludedMeasurement, exclusion_warnings
from core.session.model import NO_TARGET, ImageObservation, SessionData


def session(images: int) -> SessionData:
    observed = tuple(
        ImageObservation(f"mea_{i}", "P1", i + 1, f"{i}", NO_TARGET, "default", None, 64, 48)
        for i in range(images)
    )
    return SessionData((), (), observed)


@pytest.mark.parametrize(
    ("codes", "advised"),
    [
        (("undecodable_image", "undecodable_image"), {"Look"}),
        (("excluded_by_user",), set()),
        (("excluded_by_user", "undecodable_image"), {"Look"}),
        (("image_size_differs",), {"Give", "Upload"}),
        (("image_size_differs", "target_not_found", "excluded_by_user"), {"Give", "Look", "Upload"}),
    ],
)
def test_images_are_counted_and_advice_is_of_those_that_can_be_mended(
    codes: tuple[str, ...], advised: set[str]
) -> None:
    excluded = {f"mea_{i}": ExcludedMeasurement(f"mea_{i}", code, "") for i, code in enumerate(codes)}
    (warning,) = exclusion_warnings(session(8), excluded)
    assert warning.code == "images_excluded"
    assert [int(one) for one in re.findall(r"\d+", warning.detail)[:2]] == [len(codes), 8]
    assert all(f"{code} ({codes.count(code)})" in warning.detail for code in codes)
    sentences = re.findall(r"(?:^|\. )(\w+)", warning.advice or "")
    assert set(sentences) == advised


def test_nothing_is_said_where_every_image_counts() -> None:
    assert exclusion_warnings(session(8), {}) == []
