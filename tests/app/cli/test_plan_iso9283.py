"""`gridpose robots plan iso9283`: files of a plan, what is predicted, and wrong options."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import pypdfium2
import pytest
from typer.testing import CliRunner, Result

from app.analyses.documents.iso9283 import plan as planning
from app.cli.main import app
from core.simulation import forecast_repeatability

PLAN = (
    "robots",
    "plan",
    "iso9283",
    "--kind",
    "chessboard",
    "--columns",
    "14",
    "--rows",
    "10",
    "--pitch-mm",
    "20",
)
CELL = ("--side-mm", "200", "--focal-length-mm", "8", "--pixel-pitch-um", "3.45", "--cycles", "10")


def run(*arguments: str, code: int = 0) -> Result:
    done = CliRunner().invoke(app, [*PLAN, *CELL, *arguments])
    assert done.exit_code == code, done.output
    return done


@pytest.fixture
def few_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few robots are drawn for the forecast, where a test looks at nothing of it: two hundred take seconds."""
    monkeypatch.setattr(planning, "forecast_repeatability", partial(forecast_repeatability, draws=10))


@pytest.mark.slow
def test_a_plan_is_written_in_three_forms_and_its_poses_can_be_loaded(served: Any, tmp_path: Path) -> None:
    files = [tmp_path / f"plan.{suffix}" for suffix in ("json", "csv", "pdf")]
    outputs = [part for file in files for part in ("-o", str(file))]
    done = run("--centre-mm", "900,0,450", "--limit-mm", "1", *outputs)
    plan = json.loads(files[0].read_text(encoding="utf-8"))
    assert [pose["pose_id"] for pose in plan["poses"]] == ["P1", "P2", "P3", "P4", "P5"]
    assert plan["poses"][0]["position_mm"] == [900.0, 0.0, 450.0]
    assert plan["images"] == 54
    assert all(one["in_view"] and one["noise_floor_mm"] > 0.0 for one in plan["forecast"])
    assert plan["acceptance"]["pass"] == 1.0
    assert "pass 100%" in done.stdout
    session = served.make_session()
    key = served.client.headers["authorization"].removeprefix("Bearer ")
    settings = {"GRIDPOSE_URL": str(served.client.base_url), "GRIDPOSE_KEY": key}
    loaded = CliRunner().invoke(app, ["poses", "load", str(files[1]), "--session", session], env=settings)
    assert loaded.exit_code == 0, loaded.output
    stored = {p["pose_id"]: p for p in served.client.get(f"/v1/sessions/{session}/poses").json()["items"]}
    for pose in (*plan["poses"], *plan["additional_poses"]):
        assert pose.items() <= stored[pose["pose_id"]].items()
    text = pypdfium2.PdfDocument(files[2])[0].get_textpage().get_text_range()
    assert "P5, P4, P3, P2, P1" in text
    assert "900.000" in text


@pytest.mark.usefixtures("few_draws")
def test_a_folder_that_is_not_there_is_said(tmp_path: Path) -> None:
    assert "cannot be written" in run("-o", str(tmp_path / "no" / "plan.csv"), code=1).stderr


@pytest.mark.usefixtures("few_draws")
def test_poses_beyond_the_image_are_named() -> None:
    assert "not wholly in the image" in run("--side-mm", "500").stdout


@pytest.mark.parametrize(
    "arguments",
    [
        ("--centre-mm", "1,2"),
        ("--orientation-deg", "a,b,c"),
        ("--image", "2448"),
        ("--distance-mm", "0"),
        ("--tilt-deg", "90"),
        ("--output", "plan.doc"),
    ],
)
def test_options_that_cannot_be_are_refused_with_advice(arguments: tuple[str, ...]) -> None:
    assert run(*arguments, code=2).stderr.strip()


@pytest.mark.parametrize(
    "arguments",
    [("--side-mm", "0"), ("--plane", "C1"), ("--rp-mm", "0"), ("--distance-mm", "100")],
)
def test_a_plan_that_determines_nothing_ends_with_one(arguments: tuple[str, ...]) -> None:
    assert run(*arguments, code=1).stderr.strip()


@pytest.mark.slow
@pytest.mark.usefixtures("few_draws")
def test_loads_speeds_and_approaches_are_planned(tmp_path: Path) -> None:
    files = [tmp_path / f"plan.{suffix}" for suffix in ("json", "csv", "pdf")]
    outputs = [part for file in files for part in ("-o", str(file))]
    conditions = ("--load-kg", "5", "--speed-percent", "100", "--speed-percent", "50", "--warm-up-min", "60")
    done = run(*conditions, "--approaches", "3", "--approach-mm", "40", *outputs)
    plan = json.loads(files[0].read_text(encoding="utf-8"))
    assert [(one["load_kg"], one["speed_percent"]) for one in plan["runs"]] == [(5.0, 100.0), (5.0, 50.0)]
    assert len(plan["approach_poses"]) == 9
    assert plan["images"] == 2 * (10 * (5 + 9) + 4)
    first = plan["approach_poses"][0]
    assert (first["pose_id"], first["approach"]) == ("P1_from_x", "x")
    assert first["approach_from_mm"][0] == first["position_mm"][0] + 40.0
    rows = files[1].read_text(encoding="utf-8").splitlines()
    assert rows[0].endswith(",approach")
    assert sum(row.endswith(",z") for row in rows) == 3
    text = pypdfium2.PdfDocument(files[2])[0].get_textpage().get_text_range()
    assert "speed 50 %" in text
    assert "P4_from_z" in text
    assert "views that determine the lens; send them without a cycle number" in text
    assert "Warm-up of 60 min" in done.stdout
    assert "T1, T2, T3, T4 are taken once" in done.stdout
    assert "more than 0" in run("--speed-percent", "0", code=2).stderr
    assert "longer than 0" in run("--approaches", "2", "--approach-mm", "0", code=2).stderr
