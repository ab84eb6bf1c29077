"""Why cycles are not steady: the drawing and the report name the sign that holds, in one unit."""

from __future__ import annotations

import numpy as np
import pytest

from app.analyses.documents.plots.steadiness_panels import _moved, steadiness_panels, steadiness_summary
from app.analyses.documents.repeatability.steadiness import steadiness_document
from app.reports.forms.repeatability.cycles import steadiness_blocks
from app.reports.steadiness import steadiness_figure
from app.reports.svg import drawing_style
from core.session import SessionRepeatability, assess_repeatability
from tests.support.simulation import session_cycles as made


@pytest.fixture(scope="module")
def split() -> SessionRepeatability:
    """A robot whose second pose stops at two points, now here, now there."""
    rng = np.random.default_rng(3)
    cycles = made.gaussian(rng, 20)
    cycles[:, 1] += np.where(rng.permutation(20)[:, None] < 8, [0.0, 0.0, 2.0], 0.0)
    return assess_repeatability(made.measured_session(cycles))


def test_two_stopping_points_are_named_as_the_reason(split: SessionRepeatability) -> None:
    found = split.steadiness
    assert found.found.p_values is not None
    assert found.found.p_values.overall > 0.01
    assert [found.pose_ids[one.pose] for one in found.found.two_points] == ["P2"]
    assert steadiness_summary(found).startswith("not steady: two stopping points at P2   ·   p ")
    document = steadiness_document(found, split.poses)
    (_, block) = steadiness_blocks({"steadiness": document})
    assert block["rows"][0] == ["steady", "no: two stopping points at P2"]


def test_a_legend_names_trends_where_a_panel_has_one(split: SessionRepeatability) -> None:
    panels = steadiness_panels(split.steadiness, ["P1", "P2"])
    assert all(panel.line_mm is None for panel in panels)
    with drawing_style():
        (legend,) = steadiness_figure(panels, "title", "summary", "cycle").legends
    said = [text.get_text() for text in legend.get_texts()]
    assert said[:3] == ["x: cycle", "y: cycle", "z: cycle"]
    assert not any("cycle, trend" in one for one in said)


def test_a_sentence_on_a_movement_has_one_unit() -> None:
    """Of two lengths one is above .1 mm, from which on plots state mm, and one below."""
    limits = np.array([0.02, 0.03, 0.05])
    said = _moved(np.array([0.12, 0.0, 0.0]), np.array([0.01, 0.01, 0.01]), limits)
    assert said.startswith("moved 0.120 ± 0.010 mm by its trend (chance alone: up to 0.05")
    assert "µm" not in said
    said = _moved(np.array([0.05, 0.0, 0.0]), np.array([0.01, 0.01, 0.01]), 3.0 * limits)
    assert said.startswith("moved 0.050 ± 0.010 mm by its trend (chance alone: up to 0.1")
