"""Plots are drawn of plain values: what they show is where it belongs, nothing hides anything, odd poses included."""

from __future__ import annotations

import hashlib
import itertools
import os
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Annotation, Text

from app.reports.camera_plots.coverage_cells import ProjectionField, coverage_cells
from app.reports.camera_plots.projection_map import projection_figure, projection_svg
from app.reports.camera_plots.residual_cells import ResidualField, cells_of
from app.reports.camera_plots.residual_map import residuals_svg
from app.reports.drift import _signed, drift_figure, drift_svg
from app.reports.scatter import scatter_svg
from app.reports.svg import drawing_style, head_with, unsigned_zero
from tests.support.image.plotted import (
    DRAWINGS,
    ODD_DRIFTS,
    ODD_FIELDS,
    ODD_PROJECTIONS,
    ODD_SCATTERS,
    drifting,
    field,
    joint_panels,
    scatter,
)


def headed(figure: Figure) -> Figure:
    """The same with what it is about above it, in letters as wide as they come."""
    head_with(figure, f"{'W' * 40} · robot {'M' * 40} · images of 2026-11-20 to 2026-11-23")
    return figure


PLOTS = DRAWINGS | {"headed": lambda: headed(drift_figure([drifting()], "title", 10))}


def boxes(figure: Figure) -> list[tuple[str, Any]]:
    """What is written, and where with the frame about it, in pixels."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    found = []
    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        if text.get_text() and text.get_visible() and not isinstance(text, Annotation):
            frame = text.get_bbox_patch()
            found.append((text.get_text(), (frame or text).get_window_extent(renderer)))
    for axes in figure.axes:  # labels of ticks beyond the axes' ends are not drawn
        low, high = axes.get_xlim(), axes.get_ylim()
        for axis, (start, end) in ((axes.xaxis, low), (axes.yaxis, high)):
            hidden = [
                tick.label1.get_window_extent(renderer).bounds
                for tick in axis.get_major_ticks()
                if not min(start, end) <= tick.get_loc() <= max(start, end)
            ]
            found = [(said, box) for said, box in found if box.bounds not in hidden]
    return found


@pytest.mark.parametrize("name", PLOTS)
def test_nothing_written_hides_another_or_leaves_the_sheet(name: str) -> None:
    with drawing_style():
        figure = PLOTS[name]()
        sheet = figure.bbox
        written = boxes(figure)
    assert len(written) > 10
    for said, box in written:
        assert min(box.x0, box.y0, sheet.x1 - box.x1, sheet.y1 - box.y1) >= -0.5, said
    for (one, a), (other, b) in itertools.combinations(written, 2):
        apart = a.x1 <= b.x0 + 0.6 or b.x1 <= a.x0 + 0.6 or a.y1 <= b.y0 + 0.6 or b.y1 <= a.y0 + 0.6
        assert apart, f"{one!r} and {other!r} overlap"


DOCUMENTS: dict[str, Callable[[], bytes]] = {
    "scatter": lambda: scatter_svg(ODD_SCATTERS, "pooled"),
    "drift": lambda: drift_svg(ODD_DRIFTS, "Drift", 10),
    "residuals": lambda: residuals_svg(ODD_FIELDS, "Residuals"),
    "projection": lambda: projection_svg(ODD_PROJECTIONS, "Projection uncertainty"),
}


@cache
def document(name: str) -> bytes:
    """Return a document as this process draws it the first time."""
    return DOCUMENTS[name]()


@pytest.mark.parametrize("name", DOCUMENTS)
def test_a_document_stands_for_itself(name: str) -> None:
    """White paper, a title and words for those who cannot see it, and nothing from another host."""
    svg = document(name)
    root = ElementTree.fromstring(svg)
    space = "{http://www.w3.org/2000/svg}"
    assert root.tag == f"{space}svg"
    title, description = root.find(f"{space}title"), root.find(f"{space}desc")
    assert title is not None
    assert title.text
    assert description is not None
    assert description.text
    assert len(description.text.splitlines()) >= 4
    paper = root.find(f".//{space}g[@id='patch_1']/{space}path")
    assert paper is not None
    assert "fill: #ffffff" in paper.attrib["style"]
    assert not root.findall(f".//{space}text")  # outlines: no font is asked for
    addresses = set(re.findall(r"https?://[^\"' <]+", svg.decode()))
    assert addresses <= {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}
    for element in root.iter():
        for attribute, value in element.attrib.items():
            if attribute.endswith("href"):
                assert value.startswith(("#", "data:image/png"))
        assert element.tag not in (f"{space}script", f"{space}foreignObject", f"{space}a")


@pytest.mark.slow
def test_the_same_figures_are_the_same_bytes_in_any_process() -> None:
    """Whatever the seed of hashes, the time that builds are dated by, and what was drawn before."""
    names = ("scatter", "drift", "residuals")
    program = (
        "import hashlib\n"
        "from tests.app.reports.test_plots import DOCUMENTS\n"
        f"print(*[hashlib.sha256(DOCUMENTS[name]()).hexdigest() for name in {names}])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=Path(__file__).parents[3],
        env={**os.environ, "PYTHONHASHSEED": "2", "SOURCE_DATE_EPOCH": "2"},
        capture_output=True,
        text=True,
        check=True,
    )
    said = done.stdout.split()
    assert said == [hashlib.sha256(document(name)).hexdigest() for name in names]
    assert len(set(said)) == 3


def test_the_look_is_the_projects_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Settings of matplotlib that a user made stay as they are, and change no plot."""
    import matplotlib as mpl

    before = scatter_svg([scatter()], "pooled")
    with mpl.rc_context({"axes.facecolor": "black", "font.size": 20.0, "svg.fonttype": "none"}):
        assert scatter_svg([scatter()], "pooled") == before
        assert mpl.rcParams["font.size"] == 20.0


def test_a_folder_that_may_not_be_written_is_no_matter(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    done = subprocess.run(
        [sys.executable, "-c", "import app.reports.svg"],
        cwd=Path(__file__).parents[3],
        env={**os.environ, "MPLCONFIGDIR": str(tmp_path / "file" / "folder")},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stderr == ""


def test_no_shift_has_a_minus_before_zero() -> None:
    assert [_signed(value, 1) for value in (-0.04, 0.04, -0.06, 1.25)] == ["0.0", "0.0", "−0.1", "+1.2"]
    assert [unsigned_zero(text) for text in ("-0", "-0.00", "-0.01", "12")] == ["0", "0.00", "−0.01", "12"]
    assert joint_panels()[1].unvisited == "not visited: 0° to 40°"


def test_what_a_drawing_is_about_stands_above_it_and_moves_nothing() -> None:
    with drawing_style():
        before = drift_figure([drifting()], "title", 10)
        after = headed(drift_figure([drifting()], "title", 10))
        sizes = [figure.get_size_inches()[1] for figure in (before, after)]
        for one, other in zip(before.axes, after.axes, strict=True):
            for edge in ("y0", "y1"):
                places = [
                    getattr(axes.get_position(), edge) * h
                    for axes, h in zip((one, other), sizes, strict=True)
                ]
                assert places[0] == pytest.approx(places[1])
    title = ElementTree.fromstring(scatter_svg([scatter()], "Scatter", "Cell <4> · 2026-11-20"))[0].text
    assert title == "Scatter: Cell <4> · 2026-11-20"


def test_drift_is_reported_with_its_uncertainty() -> None:
    pose = drifting(slope=0.01, sigma=0.005)
    description = ElementTree.fromstring(drift_svg([pose], "pooled", 10)).findtext(
        "{http://www.w3.org/2000/svg}desc"
    )
    assert description is not None
    said = re.search(
        r"moved ([\d.]+) ± [\d.]+ mm.*x, y, z: \+([\d.]+), .*standard errors ([\d.]+)", description
    )
    assert said is not None
    moved, x, error = map(float, said.groups())
    assert x == pytest.approx(0.2, abs=4.0 * error)
    assert moved == pytest.approx(x, abs=4.0 * error)
    # Within a block the slope adds its own spread: 0.01 mm x √(99/12) of ten cycles, over √10, at both ends.
    assert error == pytest.approx(np.sqrt(2 * (0.005**2 + 0.01**2 * 110 / 12) / 10), rel=0.3)


def flagged(residual_fields: Sequence[ResidualField]) -> list[float]:
    return [float(np.mean(cells_of(f).stands_out)) for f in residual_fields]


def test_cells_recover_the_mean_residual_and_distinguish_chance_from_lens() -> None:
    plain, bent = field(n=20000), field(n=20000, bend=0.02)
    of_plain, of_bent = flagged([plain, bent])
    # One cell of a hundred by chance: of some 700 cells within four standard deviations of 7.
    assert of_plain < 0.01 + 4.0 * np.sqrt(0.01 / len(cells_of(plain).count))
    assert of_bent > 0.5
    cells = cells_of(bent)
    off = 2.0 * cells.middle_px / (2448, 2050) - 1.0
    expected = 0.02 * off * np.sum(off * off, axis=1)[:, None]
    pull = (cells.mean_px - expected) / (0.02 / np.sqrt(cells.count))[:, None]
    assert 0.8 < float(np.sqrt(np.mean(pull**2))) < 1.25
    assert int(cells.count.sum()) == 20000


def test_cells_without_points_are_hatched_and_named() -> None:
    u, v = np.meshgrid(np.linspace(250.0, 599.0, 40), np.linspace(0.0, 479.0, 40))
    cells = coverage_cells(np.column_stack([u.ravel(), v.ravel()]), 600, 480)
    blank = int(np.count_nonzero(cells.count == 0))
    found = ProjectionField("default", 5, cells, np.where(cells.count == 0, 0.5, 0.1))
    with drawing_style():
        figure = projection_figure([found], "title")
    hatched = [[p for p in axes.patches if p.get_hatch()] for axes in figure.axes]
    assert [len(panel) for panel in hatched if panel] == [blank, blank]
    assert [area.name for area in found.areas if area.is_blank] == [
        "upper left corner",
        "left edge",
        "lower left corner",
    ]
    assert (found.largest_covered_px, found.largest_blank_px) == (0.1, 0.5)
    assert cells.count.sum() == 1600
