"""The covariance of axes at home: its derivatives against differences, with links of every kind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.geometry.se3 import invert, so3_exp, transform
from core.kinematics.circle_point_analysis.covariance import ArcTree, axes_from_fits
from core.kinematics.circle_point_analysis.home_configuration import axes_at_home, find_home
from core.kinematics.circle_point_analysis.target_registration import (
    STEP_MM,
    STEP_RAD,
    TargetLink,
    by_arcs,
    shared_axes,
)
from core.kinematics.joint_axes.axis_fit import AxisFits, fit_axes
from core.kinematics.sweeps import JOINT_TOLERANCE, find_sweeps
from core.simulation.arm import KR5_ARC_HOME, kr5_arc, sweep_angles
from tests.support.simulation.simulated_poses import Repeatability, measure_poses

Swept = tuple[AxisFits, np.ndarray, ArcTree, ArcTree, np.ndarray]
TOLERANCE = 2.0 * JOINT_TOLERANCE


@pytest.fixture(scope="module")
def swept() -> Swept:
    """Two targets, of every joint arcs at several settings; the tree by arcs, and with the link by poses."""
    rng = np.random.default_rng(3)
    arm = kr5_arc(rng)
    away = KR5_ARC_HOME + np.radians([0.0, 0.0, -20.0, 5.0, 30.0, 10.0])
    other = KR5_ARC_HOME + np.radians([15.0, -8.0, 10.0, 25.0, -12.0, 0.0])
    q = np.concatenate([sweep_angles(h, steps=7) for h in (KR5_ARC_HOME, other, away)])
    target = np.repeat([0, 0, 1], len(q) // 3)
    poses = measure_poses(arm, q, rng, robot=Repeatability(0.1, 1e-4), target=target)
    fits = fit_axes(poses, find_sweeps(poses))
    assert len(fits.arcs) == 18
    home = find_home([arc.sweep for arc in fits.arcs], 6, JOINT_TOLERANCE)
    T = arm.T_target_base[0] @ invert(arm.T_target_base[1])
    C = np.diag([0.01] * 3 + [1e-8] * 3)
    tree = ArcTree.grown(fits, home, poses, TOLERANCE)
    of_poses = {0: tree.links[0], 1: TargetLink(T, C, 1)}
    return fits, home, tree, replace(tree, links=of_poses, not_from_arcs={1: C}), C


@pytest.mark.parametrize("given", [False, True])
def test_covariance_is_that_of_differences(given: bool, swept: Swept) -> None:
    fits, home, by_themselves, by_link, C = swept
    tree = by_link if given else by_themselves
    lines = axes_from_fits(fits)
    pairs = shared_axes(lines, 0, 1, TOLERANCE)
    assert len(pairs) > 1
    T = np.array([np.eye(4), tree.links[1].T_first_target])
    steps = np.diag([STEP_MM] * 2 + [STEP_RAD] * 2)
    uncertain = tree.uncertain(fits)

    def change(ahead: tuple, behind: tuple, step: float) -> np.ndarray:
        one, two = (axes_at_home(moved, home, link) for moved, link in (ahead, behind))
        shift = np.einsum("jia,ji->ja", uncertain.bases, one.points - two.points)
        turn = np.einsum("jia,ji->ja", uncertain.bases, np.cross(two.directions, one.directions))
        return np.hstack([shift, turn]).ravel() / (2.0 * step)

    def moved(arc: int, step: np.ndarray) -> tuple:
        at = lines.moved(arc, step)
        return at, T if given else np.array([np.eye(4), by_arcs(at, pairs)])

    J = np.column_stack(
        [
            change(moved(arc, s), moved(arc, -s), float(s.sum()))
            for arc in range(len(fits.arcs))
            for s in steps
        ]
    )
    covariance = J @ fits.covariance @ J.T
    if given:

        def shifted(step: np.ndarray) -> tuple:
            return lines, np.array(
                [np.eye(4), transform(so3_exp(step[3:]) @ T[1, :3, :3], T[1, :3, 3] + step[:3])]
            )

        columns = np.diag([STEP_MM] * 3 + [STEP_RAD] * 3)
        K = np.column_stack([change(shifted(s), shifted(-s), float(s.sum())) for s in columns])
        covariance += K @ C @ K.T
    unit = np.sqrt(np.diag(covariance))
    # Derivatives ignore how weights of averages change with the lines themselves: a thousandth of their uncertainty.
    np.testing.assert_allclose(
        uncertain.covariance / np.outer(unit, unit), covariance / np.outer(unit, unit), atol=5e-3
    )
    np.testing.assert_allclose(np.sqrt(np.diag(uncertain.covariance)), unit, rtol=2e-3)


def test_a_link_s_uncertainty_is_carried_along(swept: Swept) -> None:
    fits, _, _, tree, _ = swept
    certain = replace(tree, not_from_arcs={1: np.zeros((6, 6))})
    assert np.trace(tree.uncertain(fits).covariance) > np.trace(certain.uncertain(fits).covariance)
