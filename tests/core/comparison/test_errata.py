"""Each erratum of the paper, shown by numbers on an exact view; equation numbers are the paper's.

Symbols are the paper's: L1, L2, L3 and b4 of (8), (13), (19) and (20); h of (18); α, β, γ, δ.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.calibration import vanishing_point
from core.comparison import eight_solutions, literal_variant
from core.errors import DegenerateGeometry
from core.geometry import Camera, invert, project, so3_exp, transform, transform_points
from core.targets import GridPoints, TargetSpec

TARGET = TargetSpec("chessboard", 7, 5, 20.0)
CAMERA = Camera(2300.0, 2340.0, 1200.0, 1010.0)
CENTRE = (CAMERA.cx_px, CAMERA.cy_px)
R = so3_exp(math.radians(32.0) * np.array([0.6, 0.8, 0.0])) @ so3_exp(np.array([0.0, 0.0, 0.3]))
T = transform(R, np.array([-40.0, -30.0, 600.0]))


def view(pose: np.ndarray = T, noise_px: float = 0.0, seed: int = 0) -> GridPoints:
    px = project(transform_points(pose, TARGET.points_target()), CAMERA)
    px = px + noise_px * np.random.default_rng(seed).standard_normal(px.shape)
    row, column = (a.ravel() for a in np.mgrid[0:5, 0:7])
    return GridPoints(TARGET, 2448, 2050, column, row, px, np.full(len(px), 0.01))


SEEN = view()
X, Y = SEEN.points_target[:, :2].T
U, V = SEEN.points_px.T
TZ, R31, R32 = float(T[2, 3]), float(R[2, 0]), float(R[2, 1])
H = X * R31 + Y * R32 + TZ
INSIDE = (SEEN.row > 0) & (SEEN.column > 0)
L3 = np.stack([X, Y, H, np.ones_like(X)], axis=1)[INSIDE]


def test_8_the_first_row_gives_equations_for_its_columns() -> None:
    """(8) "m rows": the points on the x axis are n - 1, one for each further *column*; L1 has 2(n - 1) rows."""
    on_x = (SEEN.row == 0) & (SEEN.column > 0)
    assert int(on_x.sum()) == TARGET.columns - 1
    assert TARGET.columns != TARGET.rows
    x, u, v = X[on_x], U[on_x], V[on_x]
    u0, v0 = SEEN.points_px[0]
    L1 = np.concatenate(
        [
            np.stack([x, u0 - u, -u * x, 0 * x], axis=1),
            np.stack([0 * x, v0 - v, -v * x, x], axis=1),
        ]
    )
    alpha = CAMERA.fx_px * R[0, 0] + CAMERA.cx_px * R31
    beta = CAMERA.fy_px * R[1, 0] + CAMERA.cy_px * R31
    assert L1 @ [alpha, TZ, R31, beta] == pytest.approx(np.zeros(2 * (TARGET.columns - 1)), abs=1e-6)


def test_11_and_12_take_both_3_and_4_into_10() -> None:
    """Before (11): "(3) in (9)" should read "(3) and (4) into (10)"; (12) holds v11 tz, which only (4) gives."""
    on_y = (SEEN.column == 0) & (SEEN.row > 0)
    y, u, v = Y[on_y], U[on_y], V[on_y]
    u0, v0 = SEEN.points_px[0]
    gamma = CAMERA.fx_px * R[0, 1] + CAMERA.cx_px * R32
    delta = CAMERA.fy_px * R[1, 1] + CAMERA.cy_px * R32
    assert y * gamma - u * y * R32 == pytest.approx(-(u0 - u) * TZ)
    assert y * delta - v * y * R32 == pytest.approx(-(v0 - v) * TZ)
    assert v0 * TZ == pytest.approx(CAMERA.fy_px * T[1, 3] + CAMERA.cy_px * TZ)  # (4)


def test_20_has_r21_where_r11_is_printed() -> None:
    b4 = (V * H)[INSIDE]
    ty = float(T[1, 3])
    rest = [CAMERA.fy_px * R[1, 1], CAMERA.cy_px, CAMERA.fy_px * ty]
    assert L3 @ [CAMERA.fy_px * R[1, 0], *rest] == pytest.approx(b4)
    assert np.max(np.abs(L3 @ [CAMERA.fy_px * R[0, 0], *rest] - b4)) > 1e4


def test_21_and_22_need_a_pseudo_inverse_not_the_transpose() -> None:
    b3, three = (U * H)[INSIDE], L3[:, [0, 1, 3]]
    exact = np.array([CAMERA.fx_px * R[0, 0], CAMERA.fx_px * R[0, 1], CAMERA.fx_px * T[0, 3]])
    given = b3 - CAMERA.cx_px * H[INSIDE]
    assert np.linalg.pinv(three) @ given == pytest.approx(exact)
    assert np.max(np.abs(three.T @ given / exact - 1.0)) > 100.0


def test_19_to_22_are_rank_deficient_so_that_the_principal_point_is_an_artefact() -> None:
    singular = np.linalg.svd(L3 / np.linalg.norm(L3, axis=0), compute_uv=False)
    assert singular[3] < 1e-12 * singular[0]
    cx = (np.linalg.pinv(L3) @ (U * H)[INSIDE])[2]
    assert abs(cx - CAMERA.cx_px) > 50.0


def test_23_and_24_divide_by_what_vanishes_for_a_tilt_about_an_image_axis() -> None:
    """The products' form refuses two focal lengths as well; with one focal length it is exact."""
    about_x = transform(so3_exp(np.array([math.radians(30.0), 0.0, 0.0])), T[:3, 3])
    seen = view(about_x)
    with pytest.raises(DegenerateGeometry, match=r"infinite|divides by zero"):
        literal_variant(seen, CENTRE)
    square = Camera(2300.0, 2300.0, *CENTRE)
    px = project(transform_points(about_x, TARGET.points_target()), square)
    same = GridPoints(TARGET, 2448, 2050, seen.column, seen.row, px, seen.standard_uncertainty_px)
    assert vanishing_point(same, CENTRE).camera.fx_px == pytest.approx(2300.0)


def test_28_has_negative_squares_where_the_principal_point_is_wrong() -> None:
    refused = 0
    for dx in np.linspace(-1500.0, 1500.0, 13):
        try:
            literal_variant(SEEN, (CENTRE[0] + dx, CENTRE[1] - dx))
        except DegenerateGeometry as error:
            refused += "A square of (28) is negative" in error.detail
    assert refused > 2


def test_28_has_eight_solutions_of_which_one_remains() -> None:
    """As printed; and it is the one of the products' form, the route taken."""
    solutions = eight_solutions(SEEN, CENTRE)
    assert len({solution.signs for solution in solutions}) == 8
    (one,) = (solution for solution in solutions if solution.remains)
    assert (one.fx_px, one.fy_px) == (pytest.approx(CAMERA.fx_px), pytest.approx(CAMERA.fy_px))
    assert pytest.approx(R, abs=1e-9) == one.R
    assert one.t_mm == pytest.approx(T[:3, 3])
    taken = vanishing_point(SEEN, CENTRE, single_focal=False)
    assert taken.camera.fy_px == pytest.approx(one.fy_px)
    assert taken.T_camera_target == pytest.approx(transform(one.R, one.t_mm), abs=1e-6)


def test_the_literal_route_is_the_route_taken_where_it_has_an_answer() -> None:
    """In noise both have the same focal lengths, since both solve (25)-(27)."""
    both = 0
    for seed in range(30):
        seen = view(noise_px=0.3, seed=seed)
        try:
            camera, _ = literal_variant(seen, CENTRE)
        except DegenerateGeometry:
            continue
        taken = vanishing_point(seen, CENTRE, single_focal=False).camera
        assert (camera.fx_px, camera.fy_px) == (pytest.approx(taken.fx_px), pytest.approx(taken.fy_px))
        both += 1
    assert both > 20


def test_29_gives_the_last_column() -> None:
    third = np.cross(R[:, 0], R[:, 1])
    assert third == pytest.approx(R[:, 2])
    assert np.max(np.abs(third - R[2])) > 0.1


def test_31_is_the_limit_of_y() -> None:
    def at(x: float, y: float) -> np.ndarray:
        return project(transform_points(T, np.array([[x, y, 0.0]])), CAMERA)[0]

    image_of_y = CAMERA.fx_px * R[0, 1] / R32 + CAMERA.cx_px, CAMERA.fy_px * R[1, 1] / R32 + CAMERA.cy_px
    sign = math.copysign(1.0, R32)
    assert at(0.0, sign * 1e10) == pytest.approx(image_of_y, rel=1e-5)
    assert np.max(np.abs(at(math.copysign(1e10, R31), 0.0) - image_of_y)) > 100.0


def test_section_iii_the_transform_maps_world_to_camera() -> None:
    """ "From camera to World" is printed; (36)-(37) are the camera in the World only if T maps World to camera."""
    p_ee, R_ee = -R.T @ T[:3, 3], R.T
    assert transform_points(T, p_ee[None])[0] == pytest.approx(np.zeros(3), abs=1e-9)
    assert transform(R_ee, p_ee) == pytest.approx(invert(T))


def test_a_positive_tz_does_not_put_every_point_before_the_camera() -> None:
    steep = transform(so3_exp(np.array([0.0, math.radians(80.0), 0.0])), np.array([0.0, 0.0, 100.0]))
    depths = transform_points(steep, TARGET.points_target())[:, 2]
    assert steep[2, 3] > 0.0 > depths.min()


def test_ii_g_without_scaling_the_linear_transform_loses_digits() -> None:
    rows = np.zeros((2 * len(X), 9))
    for scaled in (False, True):
        x, y, u, v = (
            (X / 60.0 - 1.0, Y / 40.0 - 1.0, U / 500.0 - 2.0, V / 500.0 - 2.0) if scaled else (X, Y, U, V)
        )
        one = np.ones_like(x)
        rows[::2] = np.stack([x, y, one, 0 * x, 0 * x, 0 * x, -u * x, -u * y, -u], axis=1)
        rows[1::2] = np.stack([0 * x, 0 * x, 0 * x, x, y, one, -v * x, -v * y, -v], axis=1)
        singular = np.linalg.svd(rows, compute_uv=False)
        condition = float(singular[0] / singular[7])
        assert (condition < 1e3) if scaled else (condition > 1e5)
