"""Numbers have the digits that their use supports, in every analysis."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pytest

from app.analyses.documents.comparison import comparison_findings
from app.analyses.documents.findings import Findings, findings_document
from app.analyses.inputs.session_loader import load_session, read_markers
from app.analyses.inputs.snapshot_reader import read_snapshot
from app.analyses.worker import ANALYSES as FUNCTIONS
from app.records.numbers import encode, encode_record, rounded
from app.records.numbers.field_names import ALL_DIGITS
from tests.support.sessions.robot_session import ANALYSES, SETTINGS, RobotSession

_TEXTS = re.compile(rb'"(?:[^"\\]|\\.)*"')


def documents(robot_session: RobotSession) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield each analysis with its document before rounding."""
    with robot_session.api.installation.database.read() as records:
        data = load_session(records, read_snapshot(records, robot_session.id))
        markers = read_markers(records, robot_session.id)
    for analysis in ANALYSES:
        name = analysis.replace("-", "_")
        found = (
            comparison_findings(data, markers) if name == "comparison" else FUNCTIONS[name](data, SETTINGS)
        )
        assert isinstance(found, Findings)
        yield analysis, findings_document({}, found, data)


def pairs(exact: Any, shown: Any) -> Iterator[tuple[float, float]]:
    """Yield every number of a document with that of the rounded one."""
    if isinstance(exact, Mapping):
        assert exact.keys() == shown.keys()
        for name in exact:
            yield from pairs(exact[name], shown[name])
    elif isinstance(exact, list | tuple):
        for one, other in zip(exact, shown, strict=True):
            yield from pairs(one, other)
    elif isinstance(exact, float):
        yield exact, shown
    else:
        assert exact == shown


def uncertain(exact: Any, shown: Any) -> Iterator[tuple[float, float, float]]:
    """Yield values that have a standard uncertainty: exact, shown, and the uncertainty."""
    if isinstance(exact, list | tuple):
        for one, other in zip(exact, shown, strict=True):
            yield from uncertain(one, other)
    if not isinstance(exact, Mapping):
        return
    for name in exact:
        yield from uncertain(exact[name], shown[name])
    stated = exact.get("standard_uncertainty")
    for name, u in (stated or {}).items():
        for one, other in (
            (exact, shown),
            *((exact.get(p), shown.get(p)) for p in ("intrinsics", "distortion")),
        ):
            if one and isinstance(one.get(name), float) and u:
                yield one[name], other[name], u
    if stated and "position_mm" in exact and "x_mm" in stated:
        for axis, one, other in zip("xyz", exact["position_mm"], shown["position_mm"], strict=True):
            yield one, other, stated[f"{axis}_mm"]


def digits(text: bytes) -> int:
    return len(text.lstrip(b"-").partition(b"e")[0].replace(b".", b"").strip(b"0"))


@pytest.mark.slow
def test_no_number_is_longer_than_its_use_supports_and_none_too_short(robot_session: RobotSession) -> None:
    for analysis, exact in documents(robot_session):
        text = encode(exact)
        shown = json.loads(text)
        assert max(map(digits, re.findall(rb"-?[0-9][0-9.]*(?:e[-+]?[0-9]+)?", _TEXTS.sub(b"", text)))) <= (
            ALL_DIGITS
        ), analysis
        assert encode(shown) == text, "a rounded document is rounded"
        checked = list(uncertain(exact, shown))
        assert bool(checked) == (
            analysis in ("intrinsics", "camera-poses", "hand-eye", "repeatability", "dh")
        )
        assert all(abs(one - other) <= u / 200.0 for one, other, u in checked), analysis
        bound = max((u for *_, u in checked), default=0.0)
        for one, other in pairs(exact, shown):
            assert abs(one - other) <= max(5e-4 * abs(one), bound / 200.0)
        for one, other in pairs(exact, json.loads(encode_record(exact))):
            assert abs(one - other) <= max(1e-9 * abs(one), bound / 200.0)


def test_matrices_are_still_rotations_and_covariances(robot_session: RobotSession) -> None:
    rows = robot_session.get("camera-poses").json()["camera_poses"]
    poses = [row["pose"] for row in rows if row["pose"] is not None]
    assert len(poses) > 20
    for pose in poses:
        R = np.array(pose["rotation"])
        assert np.max(np.abs(R @ R.T - np.eye(3))) < 1e-9
        for name in ("covariance", "covariance_given_camera"):
            C = np.array(pose[name])
            unit = 1.0 / np.sqrt(np.diag(C))
            assert np.linalg.eigvalsh(C * np.outer(unit, unit))[0] > -1e-9


@pytest.mark.parametrize("u", [0.3, 9.9e-7, 12.0, 1.0])
def test_a_value_has_four_places_after_the_first_digit_of_its_uncertainty(u: float) -> None:
    value = 1234.567891234567
    shown = rounded({"a_mm": value, "standard_uncertainty": {"a_mm": u}})["a_mm"]
    step = 10.0 ** (math.floor(math.log10(u)) - 4)
    assert abs(shown - value) <= max(0.5 * step, 5e-10 * value) * 1.001
    assert shown == rounded({"a_mm": shown, "standard_uncertainty": {"a_mm": u}})["a_mm"]


def test_values_with_an_interval_are_rounded_by_its_width_and_so_are_its_ends() -> None:
    pose = {
        "mean": {"position_mm": [102.03559091, -258.37446112, -463.20016831], "roll_deg": -19.69031318},
        "repeatability": {
            "rp_l_mm": 0.09526368373,
            "rp_x_mm": 0.0380640833,
            "rp_y_mm": 0.093,
            "rp_z_mm": 0.11,
        },
        "interval": {"rp_l_mm": [0.0725922487, 0.1936449032], "rp_x_mm": None},
    }
    assert rounded(pose) == {
        "mean": {"position_mm": [102.035591, -258.374461, -463.20017], "roll_deg": -19.69031318},
        "repeatability": {"rp_l_mm": 0.09526, "rp_x_mm": 0.0380641, "rp_y_mm": 0.093, "rp_z_mm": 0.11},
        "interval": {"rp_l_mm": [0.07259, 0.19364], "rp_x_mm": None},
    }
    distance = {
        "mean_mm": 428.119219412,
        "standard_uncertainty_mm": 0.03545367507,
        "commanded_mm": 428.1234567,
        "rd_mm": 0.1088753304,
        "interval_mm": [0.07270696706, 0.2135554355],
        "ad_mm": -0.004237288,
        "ad_interval_mm": [-0.08, None],
    }
    assert rounded(distance) == {
        "mean_mm": 428.119219,
        "standard_uncertainty_mm": 0.03545,
        "commanded_mm": 428.1234567,
        "rd_mm": 0.108875,
        "interval_mm": [0.07271, 0.21356],
        "ad_mm": -0.004237,
        "ad_interval_mm": [-0.08, None],
    }


def test_a_figure_that_is_repeated_has_the_digits_of_the_first() -> None:
    pose = {
        "repeatability": {"rp_l_mm": 0.09526368373},
        "interval": {"rp_l_mm": [0.0725922487, 0.1936449032]},
    }
    total = {
        "figure": "repeatability.rp_l_mm",
        "value_mm": 0.09526368373,
        "standard_uncertainty_mm": 0.00123456,
    }
    found = rounded(
        {"poses": [pose], "acceptance": {"worst_rp_l_mm": 0.09526368373}, "budget_totals": [total]}
    )
    assert found["acceptance"] == {"worst_rp_l_mm": 0.09526}
    assert found["budget_totals"] == [
        {"figure": "repeatability.rp_l_mm", "value_mm": 0.09526, "standard_uncertainty_mm": 0.001235}
    ]


@pytest.mark.parametrize(
    ("exact", "shown"),
    [
        ({"rms_px": 0.006760161377214386}, {"rms_px": 0.00676016}),
        ({"duration_ms": 214.09506500003772}, {"duration_ms": 214.095}),
        ({"residuals": [{"position_mm": [0.02581475605]}]}, {"residuals": [{"position_mm": [0.0258148]}]}),
        ({"sigma_mm": [0.07775787563, 0.02670036667]}, {"sigma_mm": [0.07776, 0.0267]}),
        (
            {"step_mm": [1.23456789], "step_standard_uncertainty_mm": [0.012345678]},
            {"step_mm": [1.234568], "step_standard_uncertainty_mm": [0.01235]},
        ),
        (
            {"intrinsics": {"fx_px": 537.6355406123}, "standard_deviation": {"fx_px": 9.8123456}},
            {"intrinsics": {"fx_px": 537.6355}, "standard_deviation": {"fx_px": 9.812}},
        ),
        (
            {"value": 0.12345678, "low": 0.1034567, "high": 0.1567891},
            {"value": 0.123457, "low": 0.103457, "high": 0.156789},
        ),
        ({"joint_angles_deg": [-29.700903316]}, {"joint_angles_deg": [-29.70090332]}),
        ({"covariance": [[1.23456789012e-4]]}, {"covariance": [[1.23456789e-4]]}),
    ],
)
def test_each_kind_of_number_has_its_digits(exact: dict[str, Any], shown: dict[str, Any]) -> None:
    assert rounded(exact) == shown
    assert rounded(shown) == shown


@pytest.mark.parametrize("u", [0.0, None])
def test_without_an_uncertainty_a_value_has_ten_digits(u: float | None) -> None:
    found = rounded({"a_mm": -1234.567891234567, "standard_uncertainty": {"a_mm": u}, "n": 3, "zero": -0.0})
    assert json.dumps(found) == json.dumps(
        {"a_mm": -1234.567891, "standard_uncertainty": {"a_mm": u}, "n": 3, "zero": 0.0}
    )
    with pytest.raises(ValueError, match="JSON"):
        encode({"a": math.nan})


def test_a_wide_interval_leaves_its_lower_end_and_the_noise_floor() -> None:
    found = rounded(
        {
            "repeatability": {"rp_l_mm": 156.78123},
            "interval": {"rp_l_mm": [0.000135321, 648.91234]},
            "noise_floor": {"rp_l_mm": 0.00246123},
            "without_outliers": {"rp_l_mm": 0.0512345},
            "ad_mm": 1e-12,
            "ad_interval_mm": [1e-12, 3.123456789],
        }
    )
    assert found["repeatability"]["rp_l_mm"] == 156.78
    assert found["interval"]["rp_l_mm"] == [0.00014, 648.91]
    assert found["noise_floor"]["rp_l_mm"] == 0.00246123
    assert found["without_outliers"]["rp_l_mm"] == 0.051
    assert found["ad_interval_mm"] == [0.0, 3.1235]
    assert found["ad_mm"] == 0.0
