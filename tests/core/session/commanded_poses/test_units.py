"""Measured and commanded poses in different units contradict one another, and decide nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.metrology import Decision
from core.session import CommandedPose, SessionData, assess_acceptance, assess_repeatability
from core.session.commanded_poses import contradicted_unit
from core.session.model import Datasheet
from tests.support.simulation import session_cycles as made

CUBE = 150.0 * np.array([[0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1], [1, 1, 1]]) + [500.0, -100.0, 600.0]


def session(scale: float, sigma: float = 0.1, offset: float = 0.0) -> SessionData:
    """The cube read with a scale; each pose's readings turned about the commanded one by an offset."""
    rng = np.random.default_rng(2)
    x = sigma * rng.standard_normal((12, 5, 3)) + CUBE + offset * rng.standard_normal((5, 3))
    data = made.measured_session(np.zeros((12, 5, 3)))
    placed = zip(data.measured, x.swapaxes(0, 1).reshape(-1, 3), strict=True)
    return replace(
        data,
        measured=tuple(replace(one, position_mm=scale * at) for one, at in placed),
        commanded={f"P{i + 1}": CommandedPose(place.tolist(), 0.0, 0.0, 0.0) for i, place in enumerate(CUBE)},
        datasheet=Datasheet(repeatability_mm=0.03, accuracy_mm=1.0),
    )


@pytest.mark.parametrize(("scale", "guess"), [(1e-3, "metres"), (1.0 / 25.4, "inches"), (1e3, "micrometres")])
def test_a_contradiction_is_said_and_nothing_is_decided(scale: float, guess: str) -> None:
    data = session(scale)
    found = assess_repeatability(data)
    (warning,) = [one for one in found.warnings if one.code == "units_contradict"]
    assert guess in warning.detail
    decided = assess_acceptance(data, found)
    assert decided.repeatability is not None
    assert decided.repeatability.found.decision is Decision.INCONCLUSIVE
    assert "not in one unit" in decided.repeatability.found.reason
    # Frames of poses that differ a thousandfold in size are not tied.
    assert decided.accuracy is None or decided.accuracy.found.decision is Decision.INCONCLUSIVE


@pytest.mark.parametrize(
    "data", [session(1.0), session(1.0, offset=300.0), session(1.0, sigma=5.0), session(0.1), session(0.0)]
)
def test_what_is_no_unit_contradicts_nothing(data: SessionData) -> None:
    visits = {f"P{i + 1}": [one for one in data.measured if one.pose_id == f"P{i + 1}"] for i in range(5)}
    assert contradicted_unit(visits, data.commanded) is None
