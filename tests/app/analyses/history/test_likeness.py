"""Reports compared and charted: like with like, intervals, verdicts in words, lasting changes."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np
import pytest

from app.analyses.history import (
    HistoryEvent,
    NotAReport,
    Summary,
    charted_tests,
    charts_of,
    comparison_document,
    conclusion,
    group_comparable,
    history_document,
    not_stated,
    read_report,
    read_summary,
    series_of,
    summary_of,
    unlike,
)
from app.records.ids import least_id
from core.metrology import estimate_difference
from tests.support.sessions.filed_reports import FIRST, content, day, filed, joint_content


def test_the_format_is_that_of_reports() -> None:
    from app.reports.forms import FORMAT, FORMAT_VERSION

    document = json.loads(content())
    assert (document["format"], document["format_version"]) == (FORMAT, FORMAT_VERSION)


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"robot": "rob_2"}, "robots"),
        ({"source": "measured_poses"}, "instrument"),
        ({"session_inputs": {"camera_mount": "fixed"}}, "fixed"),
        ({"poses": 4}, "P4"),
        ({"height_mm": 0.1}, "P1, P2, P3"),
        ({"conditions": {"load_kg": 2.0}}, "load"),
        ({"conditions": {"speed_percent": 50.0}}, "speed"),
        ({"conditions": {"temperature_c": 22.5}}, "temperature"),
    ],
)
def test_what_makes_sessions_unlike_is_named(changes: dict[str, Any], word: str) -> None:
    (reason,) = unlike(filed(1), filed(2, **changes))
    assert word in reason


def test_sessions_of_one_test_are_comparable_and_what_is_not_stated_is_named() -> None:
    assert unlike(filed(1), filed(2, height_mm=0.005, conditions={"temperature_c": 21.5})) == []
    unstated = filed(2, conditions={"temperature_c": None})
    assert unlike(filed(1), unstated) == []
    assert not_stated(filed(1), unstated) == ["the temperature (°C)"]


@pytest.mark.parametrize(
    "wrong", [b"", b"[]", b"{}", b"null", b'{"format": 1}', content().replace(b"rp_l_mm", b"x")]
)
def test_other_files_are_no_reports(wrong: bytes) -> None:
    with pytest.raises(NotAReport) as refused:
        read_report(wrong)
    assert not refused.value.is_later


def test_a_report_of_a_later_version_is_named() -> None:
    with pytest.raises(NotAReport) as refused:
        read_report(content().replace(b'"format_version": 1', b'"format_version": 99'))
    assert refused.value.is_later


def test_without_times_of_capture_a_session_is_of_the_time_its_first_image_came() -> None:
    images = [{"received_at": day(3)}, {"received_at": day(2)}]
    assert filed(9, inputs={"images": images}).measured_at == day(9), "the time of capture comes first"
    assert filed(9, captured_at=None, inputs={"images": images}).measured_at == day(2)
    assert filed(9, captured_at=None, inputs={"images": [{}]}).measured_at == day(9), (
        "an earlier version's report"
    )
    read = {"measured_poses": [{"measurement_id": least_id("mpo", FIRST)}]}
    assert filed(9, captured_at=None, inputs=read).measured_at == day(0)


def test_a_summary_is_the_same_after_it_was_stored() -> None:
    stored = read_summary(json.loads(json.dumps(summary_of(content(3, rp_mm=0.06)))))
    whole = filed(3, rp_mm=0.06)
    assert (stored.poses, stored.conditions) == (whole.poses, whole.conditions)
    assert {key: figure.value for key, figure in stored.figures.items()} == {
        ("all poses", "RP_l"): pytest.approx(0.06),
        ("all poses", "noise floor"): pytest.approx(0.004),
    }
    assert series_of([stored]).keys() == series_of([whole]).keys()


@pytest.mark.parametrize("turn_deg", [0.0, 15.0])
def test_a_camera_mounted_anew_is_named_where_only_distances_over_a_turn_changed(turn_deg: float) -> None:
    """A camera 1 mm elsewhere on the flange, and a robot that is the same."""

    def of(number: int, camera_mm: float) -> Summary:
        def at(k: int) -> np.ndarray:
            yaw = np.radians(turn_deg * k)
            return np.array([100.0 * k + camera_mm * np.cos(yaw), camera_mm * np.sin(yaw), 0.0])

        distances = [
            {
                "from_pose_id": f"P{k}",
                "to_pose_id": f"P{k + 1}",
                "cycles": 30,
                "mean_mm": float(np.linalg.norm(at(k + 1) - at(k))),
                "standard_uncertainty_mm": 0.005,
            }
            for k in (1, 2)
        ]
        return filed(number, turn_deg=turn_deg, distances=distances)

    remounted = comparison_document(of(1, 50.0), of(2, 51.0))
    assert remounted["change_shown"] == (turn_deg > 0.0)
    assert ("mounted anew" in remounted["conclusion"]) == (turn_deg > 0.0)


def test_distances_that_share_a_pose_count_by_how_far_they_are_off() -> None:
    """Four of ten distances end at one pose: an error of its mean is in all of them."""
    same = estimate_difference(200.0, (199.996, 200.004), 200.0, (199.996, 200.004))
    poses = {
        (f"pose P{k}", "RP_l"): estimate_difference(0.05, (0.04, 0.065), 0.05, (0.04, 0.065))
        for k in range(5)
    }
    for moved, said in ((0.006, "no change is shown"), (0.03, "something changed")):
        off = estimate_difference(
            200.0, (199.996, 200.004), 200.0 + moved, (199.996 + moved, 200.004 + moved)
        )
        assert off.change == "larger"
        distances = {(f"poses P1 and P{k}", "distance"): off if k < 6 else same for k in range(2, 12)}
        assert said in conclusion({**poses, **distances}, [])


@pytest.mark.parametrize(
    "wrong", [None, [], {}, {"report_id": 1}, "text", {**summary_of(content()), "figures": [1]}]
)
def test_other_stored_values_are_no_summaries(wrong: Any) -> None:
    with pytest.raises(NotAReport):
        read_summary(wrong)


def test_few_changes_among_many_figures_are_chance() -> None:
    same = estimate_difference(0.05, (0.04, 0.065), 0.05, (0.04, 0.065))
    more = estimate_difference(0.05, (0.04, 0.065), 0.2, (0.16, 0.26))
    little = estimate_difference(0.05, (0.04, 0.065), 0.075, (0.06, 0.098))
    many = {(f"pose P{k}", "RP_l"): same for k in range(30)}
    assert "No change is shown" in conclusion(many, [])
    assert little.change == "larger"
    assert "no change is shown" in conclusion({**many, ("pose P0", "RP_l"): little}, [])
    assert "7.9 standard deviations" in conclusion({**many, ("pose P0", "RP_l"): more}, [])
    assert "something changed" in conclusion({("pose P1", "RP_l"): more, ("pose P2", "RP_l"): more}, [])
    assert "not comparable (the load differs)" in conclusion(
        {("pose P1", "RP_l"): more}, ["the load differs"]
    )
    assert conclusion({}, []) == "Nothing can be compared."
    assert "the load differs" in conclusion({}, ["the load differs"])


def test_the_later_is_compared_with_the_earlier_whichever_is_named_first() -> None:
    found = comparison_document(filed(2, rp_mm=0.12), filed(1))
    assert (found["earlier"]["session_name"], found["later"]["session_name"]) == ("week 1", "week 2")
    assert {one["figure"] for one in found["compared_figures"]} == {"RP_l"}  # floors have no interval
    first = found["compared_figures"][0]
    assert first["ratio"] == pytest.approx(2.4)
    assert first["ratio_interval"][0] < 2.4 < first["ratio_interval"][1]
    assert (found["compared"], found["changed"], found["comparable"]) == (3, 3, True)
    assert found["expected_by_chance"] == pytest.approx(0.15)


def scattered(count: int, *, change_at: int | None = None) -> list[Summary]:
    rng = np.random.default_rng(3)
    return [
        filed(
            k,
            rp_mm=float(
                0.05
                * np.exp(rng.normal(0.0, 0.05))
                * (1.3 if change_at is not None and k >= change_at else 1.0)
            ),
        )
        for k in range(1, count + 1)
    ]


def test_a_lasting_change_is_said_of_the_sessions_that_are_comparable() -> None:
    reports = scattered(30, change_at=20)
    reports.append(filed(90, rp_mm=0.5, conditions={"load_kg": 1.0}))
    event = HistoryEvent("eve_1", day(20)[:10], "new belt", False)
    first, second = charted_tests(reports, [event])
    assert ([len(test.reports) for test in (first, second)], second.charts) == ([30, 1], {})
    (sentence,) = first.sentences.values()
    moment = r"\(2020-01-\d\d \d\d:\d\d UTC\)"
    levels = r"from 0\.0\d\d to 0\.0\d\d mm"
    said = rf"RP_l all poses went up, {levels}, since the session week \d+ {moment}; shown by week \d+ {moment}\."
    assert re.match(said, sentence)
    since = int(sentence.split("week ")[1].split()[0])
    assert abs(since - 20) <= 2
    assert series_of(reports[:1])["all poses", "noise floor"][0][1].value == pytest.approx(0.004)
    assert charts_of(series_of(reports[:19]))["all poses", "RP_l"].alarm is None
    document = history_document({"id": "rob_1", "name": "arm"}, [first, second], [event])
    (alarmed,) = [one for one in document["series"] if one["alarm"]]
    assert alarmed["alarm"]["direction"] == "up"
    assert not alarmed["limits"]["in_control"]
    points = [one for one in document["session_figures"] if one["figure"] == "RP_l" and one["test"] == 1]
    assert [one["alarm_mark"] for one in points if one["alarm_mark"]] == ["since", "shown"]
    assert points[0]["ewma"] is None
    assert (document["sessions"], len(document["session_figures"])) == (31, 62)


def test_a_session_without_one_pose_s_figure_is_no_change_of_the_others() -> None:
    """P3 repeats ten times worse than the others, and was visited once in one session: their mean falls by half."""
    rng = np.random.default_rng(8)
    reports = []
    for number in range(1, 13):
        document = json.loads(content(number))
        for k, pose in enumerate(document["analyses"]["repeatability"]["poses"]):
            value = (0.5 if k == 2 else 0.05) * float(np.exp(rng.normal(0.0, 0.05)))
            pose["repeatability"]["rp_l_mm"], pose["interval"]["rp_l_mm"] = value, [0.8 * value, 1.3 * value]
            if k == 2 and number == 9:
                pose["repeatability"]["rp_l_mm"] = pose["interval"]["rp_l_mm"] = None
        reports.append(read_summary(summary_of(json.dumps(document).encode())))
    (test,) = charted_tests(reports, [])
    chart = test.charts["all poses", "RP_l"]
    assert (len(chart.values), chart.outside, chart.alarm) == (11, (), None)
    ((report, figure),) = test.series["all poses but P3", "RP_l"]
    assert report.report_id == reports[8].report_id
    assert figure.value == pytest.approx(0.05, rel=0.2)
    assert len(test.series["all poses", "noise floor"]) == 12


def test_the_latest_report_of_a_session_counts() -> None:
    again = filed(1, report=f"rep_{9:026d}", rp_mm=0.07)
    (test,) = charted_tests([again, filed(1), filed(2)], [])
    values = [figure.value for _, figure in test.series["all poses", "RP_l"]]
    assert values == [pytest.approx(0.07), pytest.approx(0.05)]


def test_events_restart_charts_where_they_say_so() -> None:
    reports = [filed(k) for k in range(1, 10)]
    assert [len(test) for test in group_comparable(reports, [day(6)])] == [5, 4]
    assert [len(test) for test in group_comparable(reports)] == [9]


def test_a_parameter_has_its_deviation_from_the_data_sheet() -> None:
    figure = read_report(joint_content()).figures["joint 2", "a_mm"]
    assert (figure.deviation, figure.unit) == (pytest.approx(0.5), "mm")
    assert figure.interval == pytest.approx((600.304, 600.696))
