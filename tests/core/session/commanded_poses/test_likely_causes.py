"""Why no camera on the flange explains poses: the mistake is named."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from core.calibration.hand_eye import HandEyeObservation
from core.errors import InvalidArgument, NotConverged
from core.geometry import invert, transform
from core.session.commanded_poses.likely_causes import calibrate_or_explain
from tests.support.simulation.hand_eye_poses import draw_stations


def with_positions(station: HandEyeObservation, factors: list[float]) -> np.ndarray:
    T = station.T_base_flange
    return transform(T[:3, :3], T[:3, 3] * factors)


def stations(wrong: str) -> list[HandEyeObservation]:
    """Ten stations of one mistake."""
    found = draw_stations(np.random.default_rng(4), 10)
    first = found[0]
    changed = {
        "target on the flange": lambda s: {"T_target_camera": invert(s.T_target_camera)},
        "camera at rest": lambda s: {"T_target_camera": first.T_target_camera},
        "orientations missing": lambda s: {
            "T_base_flange": transform(first.T_base_flange[:3, :3], s.T_base_flange[:3, 3])
        },
        "metres": lambda s: {"T_base_flange": with_positions(s, [1e-3, 1e-3, 1e-3])},
        "inches": lambda s: {"T_base_flange": with_positions(s, [1.0 / 25.4] * 3)},
        "left-handed": lambda s: {"T_base_flange": with_positions(s, [1.0, -1.0, 1.0])},
        "other poses": lambda s: {"T_base_flange": found[int(s.pose_id[1:]) * 7 % 10].T_base_flange},
    }[wrong]
    return [dataclasses.replace(s, covariance=None, **changed(s)) for s in found]


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ("target on the flange", "With the camera fixed and the target on the flange"),
        ("camera at rest", "stands still"),
        ("orientations missing", "do not turn"),
        ("metres", "taken as metres"),
        ("inches", "taken as inches"),
        ("left-handed", "mirrored along y"),
        ("other poses", "the other way round"),
    ],
)
def test_the_likely_cause_is_named(wrong: str, words: str) -> None:
    with pytest.raises((NotConverged, InvalidArgument)) as failure:
        calibrate_or_explain(stations(wrong), "robot")
    assert words in f"{failure.value.detail} {failure.value.advice}"
