"""Markers among a thousand quadrangles: the same that OpenCV's detector finds by itself, in a time that is bounded."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from core.targets.charuco import quadrangles
from core.targets.charuco.isolated_markers import _parameters
from core.targets.charuco.quadrangles import _detected, _may_be_markers, _quadrangles, markers_in_parts

DICTIONARY = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
SIZES = (35, 42, 56, 70, 84, 112)  # px, of markers 0 to 5


@pytest.fixture(scope="module")
def floor() -> np.ndarray:
    """Dark tiles apart on a bright floor, in perspective, with markers on white paper here and there."""
    floor = np.full((1200, 1600), 190, np.uint8)
    for y in range(10, 1180, 36):
        for x in range(10, 1580, 36):
            floor[y : y + 22, x : x + 22] = 45
    for number, size in enumerate(SIZES):
        x, y = 150 + 230 * number, 200 + 130 * (number % 5)
        paper = np.pad(
            cv2.aruco.generateImageMarker(DICTIONARY, number, size // 7 * 7), size // 4, constant_values=255
        )
        floor[y : y + len(paper), x : x + len(paper)] = np.clip(paper, 40, 210)
    corners = np.float32([[0, 0], [1599, 0], [1599, 1199], [0, 1199]])
    seen = np.float32([[60, 20], [1540, 0], [1599, 1199], [0, 1180]])
    image = cv2.warpPerspective(
        floor, cv2.getPerspectiveTransform(corners, seen), (1600, 1200), borderValue=120
    )
    noise = np.random.default_rng(3).normal(0.0, 2.0, image.shape)
    return np.clip(np.rint(cv2.GaussianBlur(image, (0, 0), 0.8) + noise), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("at_a_time", [300, 4])
def test_the_same_markers_are_found(
    floor: np.ndarray, at_a_time: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(quadrangles, "_AT_A_TIME", at_a_time)
    parameters = _parameters()
    limits = parameters.minMarkerPerimeterRate, parameters.maxMarkerPerimeterRate
    assert len(_quadrangles(floor, 13, parameters)) > 1000
    expected = dict(_detected(floor, DICTIONARY, parameters))
    found = markers_in_parts(floor, DICTIONARY, parameters)
    assert sorted(number for number, _ in found) == sorted(expected)
    assert len(found) == len(SIZES)
    for number, corners in found:
        np.testing.assert_allclose(corners, expected[number], atol=0.02)
    assert (parameters.minMarkerPerimeterRate, parameters.maxMarkerPerimeterRate) == limits


def test_a_marker_in_view_twice_is_found_twice(floor: np.ndarray) -> None:
    twice = floor.copy()
    four = dict(_detected(floor, DICTIONARY, _parameters()))[3]
    (left, top), (right, bottom) = (four.min(axis=0) - 20).astype(int), (four.max(axis=0) + 20).astype(int)
    twice[900 : 900 + bottom - top, 300 : 300 + right - left] = floor[top:bottom, left:right]
    numbers = [number for number, _ in markers_in_parts(twice, DICTIONARY, _parameters())]
    assert sorted(numbers) == [0, 1, 2, 3, 3, 4, 5]


def test_plain_tiles_are_no_markers(floor: np.ndarray) -> None:
    """Hardly any of a thousand tiles is looked at again, and all markers are."""
    quads = _quadrangles(floor, 13, _parameters())
    may_be = _may_be_markers(floor, quads, 7)
    assert may_be.sum() < 60
    middles = quads[may_be].mean(axis=1)
    for _, corners in _detected(floor, DICTIONARY, _parameters()):
        assert np.linalg.norm(middles - corners.mean(axis=0), axis=1).min() < 3.0
