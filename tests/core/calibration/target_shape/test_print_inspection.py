"""A print's stretch, squareness and flatness: recovered as stated, judged, and reported in words."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from core.calibration.target_shape.deformation import Measure
from core.calibration.target_shape.estimation import estimate_target_shape
from core.calibration.target_shape.print_inspection import (
    MIN_CHECK_DIRECTIONS,
    PrintCheck,
    PrintedShape,
    PrintFinding,
    check_print,
)
from core.calibration.target_shape.rule_readings import RuleReading
from core.errors import InvalidArgument
from core.geometry.camera import project
from core.geometry.se3 import transform_points
from core.targets.specification import GridPoints, TargetSpec
from tests.support.simulation.scenes import standard_camera
from tests.support.simulation.simulated_views import draw_pose

BOARD = TargetSpec("chessboard", 9, 6, 30.0)
CAMERA = standard_camera()
SIGMA_PX = 0.02
QUARTER_TURN = np.array(
    [[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
MEASURES = ("aspect", "shear", "bow_x_mm", "bow_y_mm", "twist_mm")


def printed(
    aspect: float = 0.0, shear: float = 0.0, bow_x_mm: float = 0.0, twist_mm: float = 0.0
) -> np.ndarray:
    """Return where the points of a print so wrong are, mm; its mean pitch is the stated one."""
    places = BOARD.points_target() - BOARD.points_target().mean(axis=0)
    x, y = places[:, 0], places[:, 1]
    half = places.max(axis=0)
    return np.stack(
        [
            (1.0 + aspect / 2.0) * x + shear / 2.0 * y,
            (1.0 - aspect / 2.0) * y + shear / 2.0 * x,
            bow_x_mm * (1.0 - (x / half[0]) ** 2) + twist_mm * x * y / (half[0] * half[1]),
        ],
        axis=1,
    )


def shape_of(
    seed: int, places: np.ndarray, count: int = 9, *, turned: int = 0, sigma_px: float = SIGMA_PX
) -> PrintedShape:
    """Estimate the shape of a print from points as a detector finds them, from random sides.

    After `count` views come some with the camera turned by 90°.
    """
    rng = np.random.default_rng(seed)
    row, column = (a.ravel() for a in np.mgrid[0 : BOARD.rows, 0 : BOARD.columns])
    moved = places + BOARD.points_target().mean(axis=0)
    views = []
    for number in range(count + turned):
        T = draw_pose(rng, BOARD, CAMERA, 2448, math.radians(30.0))
        if number >= count:
            T = QUARTER_TURN @ T
        exact = project(transform_points(T, moved), CAMERA)
        seen = exact + rng.normal(0.0, sigma_px, exact.shape)
        views.append(GridPoints(BOARD, 2448, 2050, column, row, seen, np.full(len(seen), sigma_px)))
    return PrintedShape.of(estimate_target_shape(views, least_directions=MIN_CHECK_DIRECTIONS))


def finding(check: PrintCheck, code: str) -> PrintFinding:
    return next(f for f in check.findings if f.code == code)


@pytest.mark.parametrize("seed", [1])
def test_a_print_as_stated_is_fine(seed: int) -> None:
    check = check_print(shape_of(seed, printed()), [RuleReading("x", 270.0, 270.02, 0.05)])
    assert check.verdict == "fine"
    assert all(f.advice is None for f in check.findings)
    assert {f.code for f in check.findings} == {
        *("aspect", "shear_rad", "bow_x_mm", "bow_y_mm", "twist_mm", "scale_x", "scale_y"),
        *("local_in_plane_mm", "local_out_of_plane_mm"),
    }


@pytest.mark.parametrize("seed", [3])
def test_a_print_longer_one_way_is_off_and_reported(seed: int) -> None:
    check = check_print(shape_of(seed, printed(aspect=0.004)))
    assert check.verdict == "off"
    worst = check.findings[0]
    assert worst.code == "aspect"
    assert worst.value == pytest.approx(0.004, abs=4.0 * worst.standard_uncertainty)
    assert worst.standard_uncertainty < 3e-4
    assert "longer along x than along y" in worst.detail
    assert "Print again at 100 %" in (worst.advice or "")
    # What the ratio indicates is no single point's fault.
    assert finding(check, "local_in_plane_mm").verdict == "fine"
    assert (check.pitch_x_mm, check.pitch_y_mm) == (None, None)
    other_way = check_print(shape_with(Measure(-0.004, 1e-4)))
    assert "longer along y than along x" in other_way.findings[0].detail


def test_shear_and_bow_are_distinguished() -> None:
    shear, bow = math.radians(0.15), 0.6
    check = check_print(shape_of(5, printed(shear=shear, bow_x_mm=bow)))
    for code, true in (("shear_rad", shear), ("bow_x_mm", bow), ("bow_y_mm", 0.0), ("aspect", 0.0)):
        found = finding(check, code)
        assert found.value == pytest.approx(true, abs=4.0 * found.standard_uncertainty), code
    assert [f.code for f in check.findings if f.verdict == "off"] == ["shear_rad", "bow_x_mm"]
    assert finding(check, "shear_rad").detail.startswith("Its axes meet at 89.8")
    assert "behind the line" in finding(check, "bow_x_mm").detail
    assert "Mount" in (finding(check, "bow_x_mm").advice or "")


def test_one_displaced_point_is_named() -> None:
    places = printed()
    places[2 * BOARD.columns + 7, :2] += (0.5, -0.3)
    check = check_print(shape_of(6, places))
    worst = check.findings[0]
    assert (worst.code, worst.verdict) == ("local_in_plane_mm", "off")
    assert "(7, 2)" in worst.detail
    assert worst.value == pytest.approx(
        math.hypot(0.5, 0.3), abs=0.1
    )  # low-order shapes take their part of it


@pytest.mark.slow
def test_measures_scatter_as_stated_even_with_few_directions() -> None:
    # Errors over uncertainties of five measures in 12 checks: Σ z² = 60 ± √(2 · 60) if they were independent.
    true = {"aspect": 0.003, "shear": 0.002, "bow_x_mm": 0.4, "bow_y_mm": 0.0, "twist_mm": -0.3}
    places = printed(true["aspect"], true["shear"], true["bow_x_mm"], true["twist_mm"])
    squares = 0.0
    for seed in range(12):
        shape = shape_of(100 + seed, places, count=MIN_CHECK_DIRECTIONS + 2)
        for name in MEASURES:
            measure = getattr(shape, name)
            squares += ((measure.value - true[name]) / measure.standard_uncertainty) ** 2
    assert squares == pytest.approx(60.0, abs=4.0 * math.sqrt(2.0 * 60.0))


def shape_with(aspect: Measure) -> PrintedShape:
    """A flat and square shape of this ratio."""
    nothing, zero = np.zeros((BOARD.size, 3)), Measure(0.0, 1e-5)
    row, column = (a.ravel() for a in np.mgrid[0 : BOARD.rows, 0 : BOARD.columns])
    return PrintedShape(BOARD, column, row, nothing, nothing + 1e-3, zero, zero, zero, aspect, zero)


def test_a_rule_gives_the_pitch_along_both_sides() -> None:
    shape = shape_with(Measure(0.004, 1e-4))
    check = check_print(shape, [RuleReading("x", 250.0, 250.5, 0.1)])
    assert check.pitch_x_mm is not None
    assert check.pitch_y_mm is not None
    assert check.pitch_x_mm.value == pytest.approx(30.0 * 1.002)
    assert check.pitch_x_mm.standard_uncertainty == pytest.approx(30.0 * 0.1 / 250.0, rel=0.01)
    assert check.pitch_y_mm.value == pytest.approx(30.0 * 1.002 / 1.004)
    assert check.pitch_y_mm.standard_uncertainty > check.pitch_x_mm.standard_uncertainty
    # A reading along the other side makes both surer; the pitches stay what the ratio says of them.
    both = check_print(shape, [RuleReading("x", 250.0, 250.5, 0.1), RuleReading("y", 150.0, 149.7, 0.1)])
    assert both.pitch_x_mm is not None
    assert both.pitch_x_mm.standard_uncertainty < check.pitch_x_mm.standard_uncertainty
    scaled = check_print(shape_with(Measure(0.0, 1e-4)), [RuleReading("y", 150.0, 144.0, 0.05)])
    assert finding(scaled, "scale_y").verdict == "off"
    assert "28.800 mm (± 0.020 mm)" in finding(scaled, "scale_y").detail
    assert "4.000 % (± 0.067 %) less than stated" in finding(scaled, "scale_y").detail


def test_what_is_too_uncertain_is_left_open_with_advice() -> None:
    check = check_print(shape_with(Measure(0.0005, 4e-4)))
    assert check.verdict == "undecided"
    assert "Add photos" in (finding(check, "aspect").advice or "")
    near = check_print(shape_with(Measure(0.00095, 4e-5)))
    assert finding(near, "aspect").verdict == "undecided"
    advice = finding(near, "aspect").advice or ""
    assert advice.startswith("It is near the limit")
    assert "Print again" in advice
    assert check_print(shape_with(Measure(0.0005, 4e-4)), limit=2e-3).verdict == "fine"


def test_the_photographs_named_bring_the_uncertainty_down_to_what_decides() -> None:
    # Without a turned camera a longer side could as well be oblong pixels; .1 % of those is as much as the limit.
    places, noise = printed(aspect=0.0016), 0.5
    few = finding(check_print(shape_of(8, places, 10, sigma_px=noise)), "aspect")
    assert few.verdict == "undecided"
    advised = re.match(r"Add about (\d+) photos with the camera turned by 90°", few.advice or "")
    assert advised is not None
    count = int(advised[1])
    assert count <= 10
    more = shape_of(8, places, 10, turned=count, sigma_px=noise)
    wanted = abs(abs(few.value) - few.limit) / 2.0
    assert more.aspect.standard_uncertainty < 1.1 * wanted
    # As many more without turning leave it open.
    unturned = shape_of(8, places, 10 + count, sigma_px=noise)
    assert unturned.aspect.standard_uncertainty > wanted


def test_what_no_number_of_photographs_decides_is_said() -> None:
    shape = shape_of(9, printed(), 10, sigma_px=0.1)
    near = replace(shape, shear=Measure(0.00101, shape.shear.standard_uncertainty))
    advice = finding(check_print(near), "shear_rad").advice or ""
    assert advice.startswith("It is too near the limit")
    assert "Print again" in advice
    # As many again, which halve the variance, decide what is .7 of it from the limit; turned ones would not help.
    u = shape.shear.standard_uncertainty
    far = replace(shape, shear=Measure(2e-4 + 2.0 * u, u), single_direction_uncertainty=np.full(5, u))
    advice = (
        finding(check_print(far, limit=2e-4 + 2.0 * u * (1.0 + math.sqrt(0.5))), "shear_rad").advice or ""
    )
    assert re.match(r"Add about 1[01] photos like these", advice)


@pytest.mark.parametrize(
    "reading",
    [RuleReading("x", 250.0, 25.0, 0.1), RuleReading("x", 0.0, 250.0, 0.1), RuleReading("y", 9.0, 9.0, 0.0)],
)
def test_readings_that_cannot_be_meant_are_refused(reading: RuleReading) -> None:
    with pytest.raises(InvalidArgument):
        check_print(shape_with(Measure(0.0, 1e-4)), [reading])


def test_a_limit_that_cannot_be_meant_is_refused() -> None:
    for limit in (0.0, -1.0, 1.0, math.nan):
        with pytest.raises(InvalidArgument):
            check_print(shape_with(Measure(0.0, 1e-4)), limit=limit)
