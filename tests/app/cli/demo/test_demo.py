"""The demo's judgement: it passes what is as it must be, and nothing else."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom
from typer.testing import CliRunner

from app.cli.demo.command import describe_image
from app.cli.demo.evaluation import Figure, ImageError, failed_checks, figures_with_truth, max_misses
from app.cli.demo.paper_figures import POSES, PRINTED
from app.cli.demo.session import FLAT, Answers, DemoSession, demo_session
from app.cli.demo.tables import METHODS, calibration_table, failures_of, methods_table
from app.cli.main import app
from core.metrology import PoseCycles, assess_repeatability

NAMES = ("rp_l_mm", "rp_x_mm", "rp_y_mm", "rp_z_mm", "rp_roll_deg", "rp_pitch_deg", "rp_yaw_deg")


@pytest.fixture(scope="module")
def session() -> DemoSession:
    return demo_session(1, quick=True)


def answered(session: DemoSession, scale: float = 1.0) -> dict[str, Any]:
    """What a perfect instrument would have the service answer, the scatter multiplied by `scale`."""
    rows = []
    for pose in session.poses:
        true = np.array([i.true_T_target_camera for i in session.images if i.pose_id == pose.pose_id])
        mean = true[:, :3, 3].mean(axis=0)
        (found,) = assess_repeatability([PoseCycles(mean + scale * (true[:, :3, 3] - mean), true[:, :3, :3])])
        factors = [np.degrees(1.0) if name.endswith("_deg") else 1.0 for name in NAMES]
        readings = [f * v for f, (_, v) in zip(factors, found.repeatability.items(), strict=True)]
        bounds = [[f * v for v in pair] for f, (_, pair) in zip(factors, found.interval.items(), strict=True)]
        rows.append(
            {
                "pose_id": pose.pose_id,
                "repeatability": dict(zip(NAMES, readings, strict=True)),
                "interval": dict(zip(NAMES, bounds, strict=True)),
                "corrected": dict(zip(NAMES, readings, strict=True)),
                "noise_floor": dict.fromkeys(NAMES, 0.001),
                "verdict": "robot",
            }
        )
    nothing = dict.fromkeys(NAMES)
    parts = ("repeatability", "interval", "corrected", "noise_floor")
    flat = {"pose_id": FLAT, **dict.fromkeys(parts, nothing), "verdict": "too_few_cycles"}
    return {"poses": [*rows, flat]}


def error(pose_id: str, ratio: float = 0.9) -> ImageError:
    return ImageError(pose_id, 0.5, 0.6, ratio, 0.02, 0.03, ratio, 0.5, 0.7)


def sound(session: DemoSession) -> tuple[Answers, list[ImageError], list[Figure]]:
    tags = [(image.pose_id, image.cycle) for image in session.images]
    measurements: list[dict[str, Any]] = [
        {"pose_id": p, "cycle": c, "failure": {"code": "focal_not_observable"} if p == FLAT else None}
        for p, c in tags
    ]
    table = answered(session)
    errors = [error(pose_id) for pose_id, _ in tags if pose_id != FLAT]
    return Answers("ses_1", measurements, table), errors, figures_with_truth(session, table)


def test_the_flat_view_comes_last_and_is_flat(session: DemoSession) -> None:
    flat = session.images[-1]
    assert (flat.pose_id, flat.cycle) == (FLAT, 1)
    assert np.degrees(np.arccos(flat.scene.T_camera_target[2, 2])) < 0.5
    assert len(session.images) == 5 * session.cycles + 1
    whole = demo_session(1)
    assert len(whole.images) == 101
    assert whole.images[0].scene.width_px == 2 * session.images[0].scene.width_px
    # The same place in the image, whose pixels are twice as wide: (0, 0) is the middle of a pixel.
    camera, half = whole.images[0].scene.camera, session.images[0].scene.camera
    assert camera.cx_px + 0.5 == pytest.approx(2.0 * (half.cx_px + 0.5))
    assert camera.cy_px + 0.5 == pytest.approx(2.0 * (half.cy_px + 0.5))


def test_what_is_sound_has_no_fault(session: DemoSession) -> None:
    answers, errors, figures = sound(session)
    assert len(figures) == 35
    assert [f.name for f in figures[:7]] == list(NAMES)
    for f in figures:
        assert f.raw == pytest.approx(f.of_these_cycles, rel=1e-9)
    assert failed_checks(session, answers, errors, figures) == []


def test_an_image_is_shown_with_standard_uncertainties() -> None:
    one = replace(error("P1"), focal_error_px=-5.0, focal_uncertainty_px=7.7, position_uncertainty_mm=4.16)
    shown = describe_image(one, 1160.0)
    assert "1155.0 ± 7.7 px" in shown
    assert "4.16 mm" in shown


def test_every_fault_is_reported(session: DemoSession) -> None:
    answers, errors, figures = sound(session)

    def said(**changes: Any) -> str:
        parts = {"answers": answers, "errors": errors, "figures": figures, **changes}
        return "; ".join(failed_checks(session, **parts))

    assert "49 of 50 tilted views" in said(errors=errors[1:])
    assert "errors are 3.0 times" in said(errors=[error(e.pose_id, 3.0) for e in errors])
    accepted = [{**m, "failure": None} for m in answers.measurements]
    assert "the flat view was not refused" in said(answers=replace(answers, measurements=accepted))
    assert "flat view" in said(answers=replace(answers, measurements=accepted[:-1]))
    assert "34 of 35 figures" in said(figures=figures[1:])
    limited = [replace(f, verdict="instrument_limited") for f in figures]
    assert "P3 is said to be instrument limited" in said(figures=limited)
    wild = [replace(f, raw=f.raw + 0.002) if f.name == "rp_x_mm" else f for f in figures]
    assert "P5: rp_x_mm reads" in said(figures=wild)
    narrow = [replace(f, low=2.0 * f.true, high=3.0 * f.true) for f in figures]
    assert "35 of 35 intervals" in said(figures=narrow)
    some = [*narrow[: max_misses(35)], *[replace(f, low=0.0, high=9.0) for f in figures[9:]]]
    assert "intervals" not in said(figures=some)


def test_a_reading_twice_as_large_is_a_fault(session: DemoSession) -> None:
    answers, errors, _ = sound(session)
    table = answered(session, scale=2.0)
    found = failed_checks(
        session, replace(answers, repeatability=table), errors, figures_with_truth(session, table)
    )
    assert any("reads" in failed_check for failed_check in found)


def test_chance_is_given_its_due() -> None:
    for count in (1, 5, 35, 200):
        allowed = max_misses(count)
        assert binom.sf(allowed, count, 0.05) <= 1e-5
        assert allowed == 0 or binom.sf(allowed - 1, count, 0.05) > 1e-5
    assert max_misses(35) == 9
    assert max_misses(0) == 0


def test_what_the_paper_printed_is_complete() -> None:
    assert [sum(PRINTED[name]["rp_l_mm"]) for name in ("proposed", "ArUco")] == pytest.approx([1.27, 5.979])
    for printed in PRINTED.values():
        assert {name: len(values) for name, values in printed.items()} == dict.fromkeys(
            ("rp_l_mm", "rp_roll_deg", "rp_pitch_deg", "rp_yaw_deg"), len(POSES)
        )


def test_methods_without_an_answer_say_why(session: DemoSession) -> None:
    _, _, figures = sound(session)
    failure = {"code": "target_without_markers", "detail": "The target has no markers.", "advice": None}
    nothing = {
        "reprojection": None,
        "intrinsics": None,
        "standard_deviation": None,
        "calibrated": 0,
        "failed": 51,
    }
    comparison = {
        "calibrations": [{"method": m, **nothing, "failures": [], "failure": failure} for m in METHODS],
        "repeatabilities": [{"method": m, "poses": [], "failure": failure} for m in METHODS],
    }
    assert calibration_table(comparison, 1160.0).row_count == len(METHODS)
    assert methods_table(comparison, {"poses": []}, figures).row_count == len(METHODS) + 4
    assert methods_table(comparison, {"poses": []}, []).row_count == len(METHODS) + 4
    assert failures_of(comparison) == [f"{' and '.join(METHODS.values())}: The target has no markers."]


def test_the_document_shows_this_very_experiment() -> None:
    """What the robot truly does follows from the seed alone, and is cheap to compute again."""
    readme = (Path(__file__).parents[4] / "docs" / "demo.md").read_text(encoding="utf-8")
    block = re.search(r"<!-- demo -->\n```\w+\n(.*?)```", readme, re.DOTALL)
    assert block is not None
    shown = [line.split()[:3] for line in block[1].splitlines() if re.match(r"P\d +\d", line)]
    session = demo_session(1)
    figures = [f for f in figures_with_truth(session, answered(session)) if f.name == "rp_l_mm"]
    assert shown == [[f.pose_id, f"{f.true:.4f}", f"{f.of_these_cycles:.4f}"] for f in figures]


def test_quick_belongs_to_the_papers_experiment() -> None:
    result = CliRunner().invoke(app, ["demo", "--quick"])
    assert result.exit_code == 2
    assert "--paper" in result.output
