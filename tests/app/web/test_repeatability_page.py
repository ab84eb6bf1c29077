"""What the page of a session's repeatability says of its figures."""

from __future__ import annotations

import re
from typing import Any

from app.reports.forms import VERDICTS as REPORTED
from app.web.pages import environment
from app.web.words import VERDICTS
from core.metrology.repeatability.verdict import Verdict


def acceptance(one: dict[str, Any], worst: dict[str, Any] | None) -> str:
    """What the page says of one limit, spaces and tags of names removed."""
    shown = environment().get_template("analyses/_decisions.html").module.acceptance  # type: ignore[attr-defined]
    stated = {"rule": "by a rule", "interval_mm": None, "cycles_needed": None, "poses_needed": None}
    text = str(shown({**stated, **one}, "acc", "Acceptance of accuracy", "AP_p", worst, 0.6, "in words"))
    return " ".join(text.replace("<bdi>", "").replace("</bdi>", "").split())


WORST = {"pose_id": "P16", "value": 0.53224, "interval": [0.4023, 0.62859]}


def test_an_open_decision_names_the_poses_that_are_open_and_no_interval_that_decides() -> None:
    reason = "24 of 28 poses are open: P5, P6 and 22 more, of fewer than ten cycles"
    said = acceptance({"decision": "inconclusive", "pose_id": None, "reason": reason}, WORST)
    assert "The largest AP_p is <b>0.532 mm</b>, at P16." in said
    assert f"It is not decided: {reason}." in said
    assert "decides" not in said
    assert "Its interval" not in said
    at_one = {"pose_id": "P3", "interval_mm": [0.3, 0.7], "reason": "the interval spans the limit"}
    said = acceptance({"decision": "inconclusive", **at_one, "cycles_needed": 26}, WORST)
    assert "It is not decided at P3: the interval spans the limit. Its interval: [0.300, 0.700] mm." in said
    assert "About 26 cycles would decide." in said


def test_a_decision_says_why_and_at_which_pose() -> None:
    one = {"pose_id": "P3", "interval_mm": [0.3, 0.5], "reason": "all lie within; nothing else was tested"}
    said = acceptance({"decision": "pass", **one}, WORST)
    assert "It is kept: all lie within; nothing else was tested. That of P3, [0.300, 0.500] mm," in said
    said = acceptance({"decision": "fail", **one}, WORST)
    assert "It is exceeded: " in said
    assert "is farthest beyond it" in said


def test_no_figure_is_named_where_it_is_missing() -> None:
    said = acceptance({"decision": "inconclusive", "pose_id": None, "reason": "no pose has cycles"}, None)
    assert "largest" not in said
    assert "–" not in said


def steadiness(p_value: float, *two_points: str) -> str:
    """What the page says of a session's steadiness by its order and its stopping points."""
    shown = environment().get_template("analyses/_decisions.html").module.steadiness_found  # type: ignore[attr-defined]
    found = {
        "p_values": {"overall_p_value": p_value},
        "common_motion": None if p_value > 0.01 else {"is_common": True},
        "steady": p_value > 0.01 and not two_points,
        "cycles": 10,
        "counted_in": "cycles",
        "two_points": [{"pose_id": one, "distance_mm": 0.2} for one in two_points],
    }
    return " ".join(re.sub("<[^>]*>", "", str(shown(found))).split())


def test_what_is_not_steady_is_said_by_the_sign_that_holds() -> None:
    chance = "% of all orders of the 10 cycles (1 % or less: not steady)"
    assert steadiness(0.3) == (
        f"✓ steady Nothing speaks against steady cycles: chance alone gives at least as much in 30 {chance}."
    )
    assert "not steady The cycles drift, jump or depend on one another: " in steadiness(0.002)
    split = steadiness(0.31, "P16", "P20")
    assert "not steady The cycles of P16 (0.200 mm), P20 (0.200 mm) stop at two points" in split
    assert (
        f"No drift, jump or dependence is seen: chance alone gives at least as much in 31 {chance}." in split
    )
    both = steadiness(0.002, "P16")
    assert "stop at two points" in both
    assert "The cycles drift, jump" in both


def test_verdicts_say_the_same_on_pages_and_in_reports() -> None:
    assert {name: state.sentence for name, state in VERDICTS.items()} == REPORTED
    assert set(VERDICTS) == {verdict.value for verdict in Verdict}
