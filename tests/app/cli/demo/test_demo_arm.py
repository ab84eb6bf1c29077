"""Table IV of the demo: errors against the truth in one gauge, and a judgement that nothing slips past."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from app.cli.demo.arm_evaluation import (
    FIELDS,
    IDENTIFIABLE,
    accuracy,
    error_over_uncertainty,
    failed_arm_checks,
    nominal_accuracy,
    parameters_with_truth,
    true_scatter_mm,
)
from app.cli.demo.arm_session import ArmAnswers, demo_arm_session
from app.cli.demo.arm_tables import accuracy_table, parameter_table, printed_from_sheet, printed_value
from app.cli.demo.paper_figures import PRINTED_LINKS
from app.cli.demo.session import demo_session
from core.kinematics.circle_point_analysis.common_normals import reparametrise
from core.kinematics.dh import Chain
from core.kinematics.identification import identify
from core.simulation.arm import KR5_ARC, KR5_ARC_HOME, Arm, sweep_angles
from core.simulation.arm_session import ArmSession
from tests.support.simulation.simulated_poses import measure_poses

PARALLEL = [False, True, False, False, False, False]
U = {"a": 0.01, "alpha": 0.001, "d": 0.01, "theta": 0.001, "beta": 0.001}
POSES = 96


@pytest.fixture(scope="module")
def session() -> ArmSession:
    return demo_arm_session(demo_session(1, quick=True).arm, 1, quick=True)


def is_identifiable(joint: int, name: str) -> bool:
    if joint == 6 or (joint, name) in {(1, "d"), (1, "theta"), (2, "d")}:
        return False
    return name != "beta" or joint == 2


def answer_of(chain: Chain) -> dict[str, Any]:
    """What the service would answer if it found this chain, in its own conventions."""
    joints, names = [], []
    for i, row in enumerate(chain.as_array()):
        values = dict(zip(FIELDS, row, strict=True))
        identifiable = {name: is_identifiable(i + 1, name) for name in FIELDS}
        names += [f"joint_{i + 1}.{field}" for name, field in FIELDS.items() if identifiable[name]]
        joint = {"joint": i + 1, "parallel_to_next": PARALLEL[i], "poses": POSES}
        for name, field in FIELDS.items():
            joint[field] = math.degrees(values[name]) if field.endswith("_deg") else values[name]
        if not PARALLEL[i]:
            joint["beta_deg"] = None
        joint["standard_uncertainty"] = {
            FIELDS[name]: U[name] if identifiable[name] else None for name in FIELDS
        }
        joint["identifiable"] = {FIELDS[name]: identifiable[name] for name in FIELDS}
        joints.append(joint)
    errors = {"position_rms_mm": 0.1, "rotation_rms_deg": 0.01}
    return {
        "joints": joints,
        "parameters": names,
        "correlation": np.eye(len(names)).tolist(),
        "validation": {
            **errors,
            "held_out_poses": 9,
            "nominal": {"position_rms_mm": 0.6, "rotation_rms_deg": 0.05},
        },
    }


def answers_of(answer: dict[str, Any]) -> ArmAnswers:
    return ArmAnswers("ses_1", {"global": answer}, {})


def perfect(arm: Arm) -> dict[str, Any]:
    return answer_of(reparametrise(arm.chain, PARALLEL, KR5_ARC))


def test_the_gauge_is_that_of_an_identification_from_exact_poses(session: ArmSession) -> None:
    """What cannot be determined has the data sheet's values, in truth and answer; the rest is the arm's own."""
    q = sweep_angles(KR5_ARC_HOME)
    exact = measure_poses(session.arm, q, np.random.default_rng(0), estimator="exact")
    found = identify(exact, KR5_ARC, folds=0).chain
    parameters = parameters_with_truth(session.arm, answer_of(found))
    assert len(parameters) == 25  # four a joint, and β of the parallel one
    assert sum(p.uncertainty is not None for p in parameters) == IDENTIFIABLE
    for p in parameters:
        assert p.identified == pytest.approx(p.true, abs=1e-6), (p.joint, p.name)
        if p.uncertainty is None:
            assert p.identified == pytest.approx(p.nominal, abs=1e-9)
    # Unlike the arm's own numbers, of which some are conventions.
    assert np.abs(session.arm.chain.as_array() - found.as_array()).max() > 0.05


def test_what_is_sound_has_no_fault(session: ArmSession) -> None:
    answer = perfect(session.arm)
    parameters = parameters_with_truth(session.arm, answer)
    assert failed_arm_checks(session, answers_of(answer), parameters) == []
    sheet = nominal_accuracy(parameters)
    assert 0.1 < sheet.lengths_mm < 1.0
    assert 0.01 < sheet.angles_deg < 0.1
    # Joints that come back to 33 µrad, some 700 mm of lever each to the camera.
    assert 0.01 < true_scatter_mm(session) < 0.05


def test_every_fault_is_reported(session: ArmSession) -> None:
    def said(answer: dict[str, Any]) -> str:
        parameters = parameters_with_truth(session.arm, answer)
        return "; ".join(failed_arm_checks(session, answers_of(answer), parameters))

    good = perfect(session.arm)
    count = len(session.images)
    good["joints"][0]["poses"] = count - 4
    assert said(good) == ""
    good["joints"][0]["poses"] = count - 6
    assert said(good) == f"{count - 6} of {count} images of the sweeps were used"

    off = perfect(session.arm)
    off["joints"][2]["a_mm"] += 6.0 * U["a"]
    assert said(off) == "a of joint 3 is 6.0 of its uncertainties from the truth"
    for joint in off["joints"]:
        joint["alpha_deg"] += 5.0 * U["alpha"]
    assert "DH parameters are off by" in said(off)

    less = perfect(session.arm)
    less["joints"][3]["identifiable"]["d_mm"] = False
    assert "17 DH parameters were identified" in said(less)

    sheet = answer_of(KR5_ARC)
    sheet["joints"][1]["beta_deg"] = 0.0
    assert "hardly nearer the truth than its data sheet" in said(sheet)

    worse = perfect(session.arm)
    worse["validation"]["position_rms_mm"] = 0.7
    assert "no better than its data sheet" in said(worse)
    assert "no better than its data sheet" in said({**worse, "validation": None})


def test_correlations_are_respected(session: ArmSession) -> None:
    answer = perfect(session.arm)
    for column, name in enumerate(("a_mm", "d_mm")):
        answer["joints"][3][name] += (1.0, -1.0)[column] * U["a"]
    identifiable = [p for p in parameters_with_truth(session.arm, answer) if p.uncertainty is not None]
    assert error_over_uncertainty(identifiable, answer) == pytest.approx(math.sqrt(2.0 / IDENTIFIABLE))
    i, j = (answer["parameters"].index(name) for name in ("joint_4.a_mm", "joint_4.d_mm"))
    answer["correlation"][i][j] = answer["correlation"][j][i] = -0.8
    # (1, -1) [[1, -.8], [-.8, 1]]⁻¹ (1, -1)ᵀ = 2 / 1.8
    assert error_over_uncertainty(identifiable, answer) == pytest.approx(math.sqrt(2.0 / 1.8 / IDENTIFIABLE))
    assert accuracy(identifiable, answer).lengths_mm == pytest.approx(U["a"] * math.sqrt(2.0 / 8.0))


def test_angles_are_compared_around_the_circle(session: ArmSession) -> None:
    answer = perfect(session.arm)
    answer["joints"][4]["theta_offset_deg"] += 360.0
    parameters = parameters_with_truth(session.arm, answer)
    assert max(abs(p.error) for p in parameters if p.is_angle) < 1e-9


def test_what_the_paper_printed_is_complete_and_far_off() -> None:
    assert {name: len(values) for name, values in PRINTED_LINKS.items()} == {"a": 5, "alpha": 5, "d": 5}
    assert [round(sum(PRINTED_LINKS[name]), 1) for name in ("a", "alpha", "d")] == [1356.5, 360.0, 226.9]
    a, alpha = printed_from_sheet()
    off = [9.6, 159.4, -14.1, 271.5, 30.1]
    assert a == pytest.approx(math.sqrt(np.mean(np.square(off))))
    assert alpha == pytest.approx(math.sqrt(np.mean(np.square([12.4, 2.4, 4.9, 4.2, 0.9]))))
    assert [printed_value(4, name) for name in ("a", "theta")] == ["271.5", "-"]
    assert printed_value(6, "a") == "-"


def test_tables_fit_and_stand_without_an_answer(session: ArmSession) -> None:
    answer = {**perfect(session.arm), "validation": None}
    parameters = parameters_with_truth(session.arm, answer)
    console = Console(width=80, record=True, file=None, quiet=False, no_color=True)
    with console.capture() as captured:
        console.print(parameter_table(parameters))
        console.print(
            accuracy_table(
                nominal_accuracy(parameters), {"global": accuracy(parameters, answer)}, {"global": answer}
            )
        )
    lines = captured.get().splitlines()
    assert max(len(line.rstrip()) for line in lines) <= 80
    assert not any("…" in line for line in lines)
    (cpa,) = [line for line in lines if line.startswith("cpa")]
    assert cpa.split()[-5:] == ["-"] * 5


def test_the_document_shows_this_very_arm() -> None:
    """How the arm is built, and how far its data sheet is off, follow from the seed alone."""
    readme = (Path(__file__).parents[4] / "docs" / "demo.md").read_text(encoding="utf-8")
    block = re.search(r"<!-- demo-dh -->\n```\w+\n(.*?)```", readme, re.DOTALL)
    assert block is not None
    arm = demo_session(1).arm
    parameters = parameters_with_truth(arm, perfect(arm))
    shown = re.findall(
        r"^(\d| )  +(a|alpha|d|theta|beta) +(-?[\d.]+) +(-?[\d.]+|-) .*", block[1], re.MULTILINE
    )
    joint = 0
    assert len(shown) == 9
    for digit, name, nominal, true in shown:
        joint = int(digit) if digit.strip() else joint
        (p,) = [p for p in parameters if (p.joint, p.name) == (joint, name)]
        assert nominal == f"{p.nominal:.3f}"
        digits = 5 if p.is_angle else 4
        assert true == ("-" if p.uncertainty is None else f"{p.true:.{digits}f}")
    sheet = nominal_accuracy(parameters)
    assert re.search(
        rf"^the data sheet +{sheet.lengths_mm:.4f} +{sheet.angles_deg:.5f} ", block[1], re.MULTILINE
    )
