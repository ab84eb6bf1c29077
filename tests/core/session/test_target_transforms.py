"""How two targets lie to one another, from images that show both: errors as large as their uncertainty says."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from core.geometry import invert, so3_exp, so3_log, transform
from core.session import (
    ImageObservation,
    SessionData,
    estimate_session,
    group_views,
    target_transforms,
    with_print_uncertainty,
)
from core.targets import TargetSpec
from tests.support.sessions.stored_sessions import BOARD, HEIGHT, WIDTH, draw_board_pose, look

OTHER = TargetSpec("chessboard", 8, 5, 12.0)
T_BOARD_OTHER = transform(so3_exp(np.array([0.0, 1.2, 0.1])), np.array([110.0, 5.0, 10.0]))


def session(seed: int, scale: float | None) -> SessionData:
    """Eight images that show both boards; `scale` is the standard deviation of both prints' scale, and stated."""
    rng = np.random.default_rng(seed)
    boards = [
        board
        if scale is None
        else dataclasses.replace(board, pitch_standard_uncertainty_mm=scale * board.pitch_mm)
        for board in (BOARD, OTHER)
    ]
    printed = [
        dataclasses.replace(board, pitch_mm=board.pitch_mm * (1.0 + (scale or 0.0) * rng.normal()))
        for board in boards
    ]
    images, points = [], {}
    while len(images) < 16:
        T = draw_board_pose(rng, 30.0)
        T[2, 3] *= 1.9
        seen = [
            look(rng, at, board=board, sigma_px=0.05)
            for at, board in zip((T, T @ T_BOARD_OTHER), printed, strict=True)
        ]
        pixels = np.concatenate([one.points_px for one in seen])
        if np.any(pixels < 0.0) or np.any(pixels > [WIDTH - 1, HEIGHT - 1]):
            continue
        for target, one in enumerate(seen):
            k = len(images)
            points[k] = dataclasses.replace(one, target=boards[target])
            images.append(
                ImageObservation(
                    f"m{k}", f"P{k // 2}", 1, f"{k // 2}", target, "default", None, WIDTH, HEIGHT
                )
            )
    return SessionData(tuple(boards), ("a", "b"), tuple(images), group_views(images, points))


@pytest.mark.parametrize("scale", [None, 1e-3])
def test_errors_are_those_stated_with_what_both_poses_of_an_image_share(scale: float | None) -> None:
    ratios = []
    for seed in range(12):
        data = session(seed, scale)
        (found,) = target_transforms(data, estimate_session(data))
        off = invert(found.T_from_to) @ T_BOARD_OTHER
        errors = np.append(found.T_from_to[:3, :3] @ off[:3, 3], so3_log(off[:3, :3]))
        ratios.append(errors**2 / np.diag(found.covariance))
    print(f"rms of error over u: {np.sqrt(np.mean(ratios, axis=0)).round(2).tolist()}")
    # Twelve sessions of six figures: a standard error of some .08.
    assert 0.7 < np.sqrt(np.mean(ratios)) < 1.3


def test_what_prints_may_depart_by_is_added() -> None:
    data = session(1, 1e-3)
    estimate = estimate_session(data)
    both = [target_transforms(data, one)[0] for one in (estimate, with_print_uncertainty(data, estimate))]
    assert np.all(np.diag(both[1].covariance) > np.diag(both[0].covariance))
    for before, after in zip(estimate.poses, with_print_uncertainty(data, estimate).poses, strict=True):
        own, same = before.own_covariance(), after.own_covariance()
        assert own is not None
        assert same is not None
        np.testing.assert_allclose(same, own, atol=1e-9 * np.abs(after.covariance).max())  # type: ignore[arg-type]
