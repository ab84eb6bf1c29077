"""The verdict `robot` of estimators whose floors hold only if their camera does."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
import pytest

from core.metrology import PoseRepeatability, Verdict
from core.session import SessionData, assess_repeatability, estimate_session, image_rows
from core.session.estimate import SessionEstimate
from core.session.repeatability.confirmation import unconfirmed
from tests.support.simulation.correlated_noise import NoisySession, noisy_session, session_data, white


def moving(robot_mm: float = 0.3) -> NoisySession:
    return noisy_session(np.random.default_rng(3), white(), poses=4, cycles=12, robot_mm=robot_mm)


def verdicts(data: SessionData, estimator: str) -> tuple[set[Verdict], list[str]]:
    found = assess_repeatability(data, estimate_session(data, estimator))
    rows = [row.figures for row in found.poses if row.figures is not None]
    return {row.verdict for row in rows}, [w.code for w in found.warnings]


@pytest.mark.parametrize("estimator", ["pooled", "given"])
def test_a_camera_that_fits_is_confirmed(estimator: str) -> None:
    session = moving()
    kinds, codes = verdicts(session_data(session, session.camera), estimator)
    assert kinds == {Verdict.ROBOT}
    assert "verdict_withheld" not in codes


def test_a_lens_that_fits_in_single_images_is_confirmed() -> None:
    """No tangential distortion and the principal point where it is held: the model of `per_image_fixed_pp`."""
    camera = dataclasses.replace(moving().camera, p1=0.0, p2=0.0, fy_px=moving().camera.fx_px)
    session = noisy_session(
        np.random.default_rng(3), white(), poses=4, cycles=12, robot_mm=1.5, camera=camera
    )
    kinds, codes = verdicts(session_data(session, camera), "per_image_fixed_pp")
    assert kinds == {Verdict.ROBOT}
    assert "verdict_withheld" not in codes


@pytest.mark.parametrize(("estimator", "robot_mm"), [("given", 0.2), ("per_image_fixed_pp", 1.5)])
def test_a_camera_that_the_residuals_reject_has_no_verdict_robot(estimator: str, robot_mm: float) -> None:
    """The principal point lies 60 px from where it is held, the focal length 2 % from the given one."""
    session = moving(robot_mm)
    off = dataclasses.replace(
        session.camera, cx_px=session.camera.cx_px + 60.0, fx_px=1.02 * session.camera.fx_px
    )
    data = session_data(session, off)
    found = assess_repeatability(data, estimate_session(data, estimator))
    assert all(Verdict.ROBOT not in dict(row.figures.verdicts.items()).values() for row in found.poses)
    (warning,) = [w for w in found.warnings if w.code == "verdict_withheld"]
    assert "variance of the noise" in warning.detail
    for row in found.poses:  # the instrument's share is not known: nothing is subtracted
        assert row.figures.corrected == row.figures.repeatability


def test_what_the_common_camera_explains_is_not_the_robots() -> None:
    """A robot at rest whose own floors are far too small: by the common camera it reads its floor."""
    session = moving(0.0)
    data = session_data(session, session.camera)
    estimate = estimate_session(data, "given")

    def figures_of(other: SessionEstimate) -> Mapping[str, PoseRepeatability]:
        rows = {row.pose_id: row.figures for row in image_rows(data, other).rows if row.figures is not None}
        if other is not estimate:
            return rows
        return {
            pose_id: dataclasses.replace(
                one,
                verdict=Verdict.ROBOT,
                verdicts=dataclasses.replace(one.verdicts, position_mm=Verdict.ROBOT),
            )
            for pose_id, one in rows.items()
        }

    held, (warning,) = unconfirmed(data, estimate, figures_of)
    assert held == {"P0", "P1", "P2", "P3"}
    assert "common camera" in warning.detail
    as_pooled = dataclasses.replace(estimate, estimator="pooled")
    assert unconfirmed(data, as_pooled, figures_of) == (frozenset(), ())
