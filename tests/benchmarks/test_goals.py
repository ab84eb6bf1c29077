"""The table of goals: what stored runs say about each number to reach."""

from __future__ import annotations

import importlib
import pkgutil
import re
from pathlib import Path

import pytest

import benchmarks
from benchmarks import trust
from benchmarks.goals import GOALS, Goal, Part, judge, judged, outcomes_table, sections_of
from benchmarks.table import Row, markdown, with_section

ROOT = Path(__file__).parents[2]
RESULTS = (ROOT / "benchmarks" / "RESULTS.md").read_text(encoding="utf-8")
RUN = "2026-11-23, commit 0123abc, 2 cores; seeds 1.\n\n"


def _stored(*rows: Row, section: str = "corners") -> str:
    return with_section("# Measured\n", section, RUN + markdown(rows))


def test_rows_and_run_are_read_back_as_they_were_kept() -> None:
    rows = (Row.at_most("a ÷ b", 0.5, 1.0, note="how"), Row.context("c", 1234.0, "ms"))
    section = sections_of(_stored(*rows))["corners"]
    assert section.rows == rows
    assert section.run == "2026-11-23 0123abc"


@pytest.mark.parametrize(
    ("values", "verdict", "measured"),
    [
        ((0.1, 0.2), "holds", "0.100 px / 0.200 px"),
        ((0.1, 0.31), "SHORT", "0.100 px / 0.310 px"),
        ((0.1, float("nan")), "SHORT", "0.100 px / nan px"),
        ((0.3, 0.1, 0.2, 0.25), "holds", "0.100 px to 0.300 px"),
    ],
)
def test_one_figure_that_is_short_makes_the_row_short(
    values: tuple[float, ...], verdict: str, measured: str
) -> None:
    goal = Goal("rms", "≤ .3", (Part("corners", "rms .*", high=0.3),))
    rows = [Row.context(f"rms {k}", value, "px") for k, value in enumerate(values)]
    outcome = judge(goal, sections_of(_stored(*rows)))
    assert outcome.verdict == verdict
    assert outcome.measured == measured
    assert outcome.run == "corners 2026-11-23 0123abc"


def test_a_goal_is_not_measured_until_all_its_parts_are_unless_one_is_short() -> None:
    sections = sections_of(_stored(Row.context("rms", 1.0)))
    here, elsewhere = Part("corners", "rms", high=1.0), Part("trust", "rms", high=1.0)
    assert judge(Goal("x", "-", (here,)), sections).verdict == "holds"
    assert judge(Goal("x", "-", (here, elsewhere)), sections).verdict == "not measured"
    assert judge(Goal("x", "-", (Part("corners", "rms", high=0.5), elsewhere)), sections).verdict == "SHORT"
    assert judge(Goal("x", "-"), sections).verdict == "not measured"


def test_a_relative_goal_is_the_rows_own() -> None:
    sections = sections_of(
        _stored(Row.at_most("GoPro: error", 2.0, 3.0), Row.at_most("Sony: error", 2.0, 1.0))
    )
    assert judge(Goal("x", "-", (Part("corners", "GoPro: .*", own=True),)), sections).verdict == "holds"
    assert judge(Goal("x", "-", (Part("corners", ".*: error", own=True),)), sections).verdict == "SHORT"


def test_every_part_names_a_section_that_exists_and_a_valid_expression() -> None:
    names = {m.name.rpartition(".")[2] for m in pkgutil.walk_packages(benchmarks.__path__, "benchmarks.")}
    for goal in GOALS:
        assert goal.parts or goal.note, goal.what
        for part in goal.parts:
            assert part.section in names, part
            re.compile(part.rows)


def test_kept_runs_have_the_rows_of_their_goals_or_say_that_they_are_older() -> None:
    sections = sections_of(RESULTS)
    for outcome in judged(sections):
        for part in outcome.goal.parts:
            kept = sections.get(part.section)
            found = kept is not None and any(re.fullmatch(part.rows, row.what) for row in kept.rows)
            assert found or "not in the kept run" in outcome.measured or "no run of" in outcome.measured


def test_the_kept_table_is_what_the_kept_runs_give() -> None:
    assert outcomes_table(judged(sections_of(RESULTS))) in RESULTS


def test_every_short_row_says_what_was_tried() -> None:
    attempts = (ROOT / "benchmarks" / "ATTEMPTS.md").read_text(encoding="utf-8")
    headings = {line.removeprefix("## ") for line in attempts.splitlines() if line.startswith("## ")}
    short = {o.goal.what for o in judged(sections_of(RESULTS)) if o.verdict == "SHORT"}
    assert headings == short


def test_the_readme_shows_rows_of_the_table_as_they_are() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    shown = readme.split("## Results\n")[1].split("\n## ")[0]
    rows = [line for line in shown.splitlines() if line.startswith("| ")][1:]
    assert len(rows) == 6
    table = outcomes_table(judged(sections_of(RESULTS)))
    for row in rows:
        what, goal, measured, verdict = (cell.strip() for cell in row.strip("|").split("|"))
        assert f"| {what} | {goal} | {measured} | {verdict} |" in table


def test_sections_are_modules_with_rows() -> None:
    for name in ("clone", "suite", "service.crowd", "service.durability"):
        assert callable(importlib.import_module(f"benchmarks.{name}").rows)


def test_section_trust_has_the_rows_of_all_its_subjects() -> None:
    names = {module.__name__.rpartition(".")[2] for module in trust.subjects()}
    assert names == {
        *("accuracy", "board_shape", "exclusion", "noise_floor", "real_arms", "rp_intervals", "steadiness")
    }
