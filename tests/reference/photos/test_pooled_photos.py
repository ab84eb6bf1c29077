"""Pooled calibration of real photographs: halves of a set agree within what they state, and the set with its reference.

On these photographs residuals are not independent: prints are bowed, one is .4 % longer one way than the other. With
independent residuals assumed the halves differ by 1.0 to 3.0 stated uncertainties (rms over splits and parameters).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from core import GridposeError, TargetSpec, calibrate_image
from core.calibration.multi_view.estimators import estimate_group
from core.calibration.multi_view.group_estimate import GroupEstimate
from core.targets.specification import GridPoints

SPLITS = 8
SETS = {
    # pattern, first and last photograph, board, the reference's mean of fx and fy
    "left": ("opencv_samples/left*.jpg", slice(None), TargetSpec("chessboard", 9, 6, 25.0), 532.4),
    "right": ("opencv_samples/right*.jpg", slice(None), TargetSpec("chessboard", 9, 6, 25.0), 534.5),
    "Sony": (
        "boofcv/Sony_DSC-HX5V_Chess/*.jpg",
        slice(None),
        TargetSpec("chessboard", 6, 4, 30.0),
        706.65,
    ),
    "Bumblebee, left eye": (
        "boofcv/Bumblebee2_Chess/*.jpg",
        slice(0, 11),
        TargetSpec("chessboard", 6, 4, 30.0),
        526.2,
    ),
    "GoPro": ("gopro_wide/*.jpg", slice(None), TargetSpec("chessboard", 8, 6, 25.0), 560.75),
}


@cache
def detected(folder: Path, name: str) -> tuple[GridPoints, ...]:
    pattern, part, target, _ = SETS[name]
    found = []
    for path in sorted(folder.glob(pattern))[part]:
        try:
            points = calibrate_image(path.read_bytes(), target).points
        except GridposeError as failure:
            points = failure.points
        assert points is not None, path.name
        found.append(points)
    return tuple(found)


@pytest.fixture
def photos(data_folder: Path) -> Callable[[str], tuple[GridPoints, ...]]:
    return lambda name: detected(data_folder, name)


def focal(found: GroupEstimate) -> tuple[float, float]:
    """Mean of fx and fy, and its standard uncertainty, px."""
    C = found.camera_covariance
    return 0.5 * (found.camera.fx_px + found.camera.fy_px), 0.5 * float(
        np.sqrt(C[0, 0] + 2.0 * C[0, 1] + C[1, 1])
    )


@pytest.mark.parametrize("name", ["left", "right", "Sony", "Bumblebee, left eye"])
def test_halves_of_a_set_agree_within_their_uncertainties(
    photos: Callable[[str], tuple[GridPoints, ...]], name: str
) -> None:
    views = photos(name)
    rng = np.random.default_rng(0)
    z, z_focal = [], []
    for _ in range(SPLITS):
        order = rng.permutation(len(views))
        half = len(views) // 2
        first, second = (
            estimate_group([views[i] for i in part], "pooled") for part in (order[:half], order[half:])
        )
        difference = (first.camera.as_array() - second.camera.as_array())[:8]
        z.append(difference / np.sqrt(np.diag(first.camera_covariance + second.camera_covariance))[:8])
        (f, u), (g, v) = focal(first), focal(second)
        z_focal.append((f - g) / np.hypot(u, v))
    # All splits are of the same dozen photographs, so that they count as few: eight parameters of one difference have
    # an rms of 1 ± .25 were they independent.
    assert 0.3 < float(np.sqrt(np.mean(np.square(z)))) < 1.5
    assert float(np.sqrt(np.mean(np.square(z_focal)))) < 1.75


@pytest.mark.parametrize("name", list(SETS))
def test_the_reference_lies_within_the_uncertainty(
    photos: Callable[[str], tuple[GridPoints, ...]], name: str
) -> None:
    found = estimate_group(photos(name), "pooled")
    f, u = focal(found)
    # The references are of the same photographs, with the model of OpenCV and no priors.
    assert abs(f - SETS[name][3]) < 3.0 * u
    assert u < 0.015 * f
    assert found.inflation > 1.25


def test_photographs_that_say_nothing_of_the_focal_length_are_refused_for_that(
    photos: Callable[[str], tuple[GridPoints, ...]],
) -> None:
    found = estimate_group(photos("Sony"), "per_image_fixed_pp")
    assert {i: failure.code for i, failure in found.failures} == dict.fromkeys(
        (0, 2, 3, 4), "focal_not_observable"
    )
