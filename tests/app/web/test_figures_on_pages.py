"""Figures on pages: their digits, intervals and decisions, in words."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest

from app.reports.forms.blocks import number as form_number
from app.reports.forms.repeatability.cycles import drift_blocks
from app.web.pages import environment
from app.web.words import (
    interval,
    length_with_uncertainty,
    number,
    rounded_by,
    rounded_by_interval,
    shown_change,
    signless_zero,
    size,
    with_uncertainty,
)
from tests.support.service.signed_in import signed_in
from tests.support.sessions.kinematics import make_robot
from tests.support.sessions.stored_sessions import new_session, shoot, store_shots, with_fields
from tests.support.sessions.tracked_robot import drawn_poses, readings, send, send_commands


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        *((None, "–"), (0.0, "0"), (-0.0, "0"), (0.0123456, "0.0123"), (9.9999, "10.0"), (-1.5, "−1.50")),
        *((123456.0, "123000"), (1e-12, "1.00e−12"), (float("nan"), "–"), (0.1, "0.100")),
    ],
)
def test_numbers_have_three_digits_and_no_minus_zero(value: float | None, shown: str) -> None:
    assert number(value) == shown


def test_values_have_the_digits_that_their_uncertainty_supports() -> None:
    assert with_uncertainty(649.9996, 0.0213) == "650.000 ± 0.021"
    assert with_uncertainty(-0.0001, 0.012) == "0.000 ± 0.012"
    assert with_uncertainty(5.0, None) == "5.00000"
    assert length_with_uncertainty([0.3, -0.4, 0.0], [0.01, 0.02, 0.5]) == "0.500 ± 0.017"
    assert length_with_uncertainty([0.0, 0.0, 0.0], [0.01, 0.02, 0.0]) == "0.000 ± 0.020"
    assert (rounded_by(69.4347193, 0.143), rounded_by(1645.85, 2700.0)) == ("69.43", "1646")
    assert (rounded_by(1160.0212, None, 6), rounded_by(None, 0.1)) == ("1160.02", "–")
    assert rounded_by_interval(1163.218, [-1.2, 0.8]) == "1163.22"
    # What is shown of the difference is that of what is shown.
    assert shown_change(427.75, 427.73, -0.02, [-2.6, 2.5]) == ("427.75", "427.73", "−0.02")
    assert shown_change(0.12345, 0.2, 0.07655, [0.05, 0.1]) == ("0.123", "0.200", "0.077")
    assert shown_change(0.2117, 0.1963, -0.0154, [-0.12, 0.09])[:2] == ("0.2117", "0.1963")
    ratio = shown_change(0.2117, 0.1963, -0.0154, [-0.12, 0.09], as_ratio=True)
    assert ratio[:2] == ("0.212", "0.196"), "no difference is shown that the digits must agree with"
    assert shown_change(1.0, 2.0, 1.0, [1.0, 1.0]) == ("1.00", "2.00", "1.00")
    assert interval([-0.0004, 0.1951]) == "[0.000, 0.195]"
    assert interval(None) == "–"
    assert (signless_zero("-0.00"), signless_zero("-0.01")) == ("0.00", "−0.01")
    assert (size(999), size(1500), size(2_340_000_000)) == ("999 bytes", "1.50 kB", "2.34 GB")


def test_the_page_says_that_cycles_are_means_of_several_images(api: Any) -> None:
    session = new_session(api)
    shots = shoot(poses=2, cycles=3)
    store_shots(api, session, [*shots, *with_fields(shoot(2, poses=2, cycles=3), burst=2)])
    page = api.client.get(f"/ui/sessions/{session}/repeatability", headers=signed_in(api)).text
    assert "read as the mean of its images: 6 stops in several images, 12 in all." in page


def test_both_decisions_on_a_data_sheet_stand_on_the_page(api: Any) -> None:
    robot = make_robot(api)
    session = new_session(api, robot_id=robot)
    poses = drawn_poses(9, 8)
    send_commands(api, session, poses)
    send(api, session, readings(poses, cycles=12))
    limits = {"datasheet_repeatability_mm": 1.0, "datasheet_accuracy_mm": 1e-4}
    address = f"/v1/robots/{robot}?accept_implausible=true"
    assert api.client.patch(address, json=limits).status_code == 200
    address = f"/ui/sessions/{session}/repeatability?source=measured_poses"
    page = api.client.get(address, headers=signed_in(api)).text
    assert "Acceptance of repeatability: pass" in page
    largest = r" is <b>0\.\d+ mm</b>, at <bdi>P\d</bdi>"
    assert re.search(f"The largest RP<sub>l</sub>{largest}", page)
    assert re.search(r"That of <bdi>P\d</bdi>, \[0\.\d+, 0\.\d+\] mm, reaches farthest", page)
    assert "Acceptance of accuracy: " in page
    assert re.search(f"The largest AP<sub>p</sub>{largest}", page)
    answer = api.client.get(f"/v1/sessions/{session}/repeatability?source=measured_poses").json()
    for pose in answer["poses"]:
        one = pose["accuracy"]
        known = one["interval"]["ap_p_mm"]
        figures = f'{rounded_by_interval(one["ap_p_mm"], known)} <span class="quiet">{interval(known)}</span>'
        held_out = rounded_by_interval(one["held_out"]["ap_p_mm"], known)
        assert f'{figures} <span class="quiet">held out {held_out}</span>' in page
    assert "held out: tied by the other poses alone." in page
    for name in ("Floor, mm", "Corrected, mm", "AD, mm", "RD, mm"):
        assert f'<th scope="col">{name}' in page
    assert answer["distances"]
    for one in answer["distances"]:
        known = one["standard_uncertainty_mm"]
        mean = with_uncertainty(one["mean_mm"], known) if known else rounded_by(one["mean_mm"], one["rd_mm"])
        assert f'<td class="num">{mean}</td>' in page


def test_readings_alone_are_shown_by_themselves(api: Any) -> None:
    session = new_session(api)
    send(api, session, readings(drawn_poses(9, 1), cycles=10, rotations=False))
    address = f"/ui/sessions/{session}/repeatability"
    page = api.client.get(address, headers=signed_in(api)).text
    assert "Not available yet" not in page
    assert "these figures are of the poses that another instrument measured" in page
    images = api.client.get(f"{address}?source=images", headers=signed_in(api)).text
    assert f'href="{address}?source=measured_poses"' in images


@pytest.mark.slow
def test_drift_has_one_uncertainty_everywhere(api: Any) -> None:
    session = new_session(api)
    poses = drawn_poses(9, 5)
    send_commands(api, session, poses)
    send(api, session, readings(poses, cycles=20))
    head = signed_in(api)
    address = f"/ui/sessions/{session}/repeatability"
    page = api.client.get(address, headers=head).text
    assert api.client.get(f"/ui/sessions/{session}/cycles.json", headers=head).json()["poses"]
    answer = api.client.get(f"/v1/sessions/{session}/repeatability?source=measured_poses").json()
    report = str(drift_blocks(answer))
    for one in answer["drift"]["poses"]:
        length, u = one["shift_distance_mm"], one["shift_distance_standard_uncertainty_mm"]
        axes = zip(one["shift_mm"], one["shift_standard_uncertainty_mm"], strict=True)
        assert u == pytest.approx(math.hypot(*(v * s for v, s in axes)) / length, rel=1e-3)
        assert f"<b>{with_uncertainty(length, u)}</b>" in page
        assert form_number(u, u) in report
        dap = one["dap_mm"], one["dap_standard_uncertainty_mm"]
        assert f"{form_number(*dap)} ± {form_number(dap[1], dap[1])}" in report


def test_an_accuracy_without_an_interval_says_so() -> None:
    shown = environment().get_template("_macros.html").module.accuracy  # type: ignore[attr-defined]
    one: dict[str, Any] = {"ap_p_mm": 0.0712618, "interval": {"ap_p_mm": None}, "held_out": {"ap_p_mm": None}}
    assert shown(one) == '0.071 <span class="quiet">no interval</span>'
    one["held_out"]["ap_p_mm"] = 0.0618545
    assert shown(one).endswith('no interval</span> <span class="quiet">held out 0.062</span>')
    one["interval"]["ap_p_mm"] = [0.05, 0.15]
    assert shown(one).startswith('0.071 <span class="quiet">[0.050, 0.150]')
    assert shown(None) == "–"
