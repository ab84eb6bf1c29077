"""What colours of a plot distinguish is distinguished without colour vision, in grey, or by another mark."""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from app.reports.svg import draw_svg
from tests.support.image.plotted import DRAWINGS, arm_schematic, workspace_map

SPACE = "{http://www.w3.org/2000/svg}"
APART = 20.0
"""Distance in CIE Lab at which two small marks are distinguished at a glance; of grey, a fifth from black to white."""
# Linear RGB of full dichromacy: G. M. Machado, M. M. Oliveira, L. A. F. Fernandes, "A physiologically-based model
# for simulation of color vision deficiency", IEEE TVCG 15 (2009) 1291-1298, doi:10.1109/TVCG.2009.113, table of
# severity 1.0.
SEEN_BY = {
    "everybody": np.eye(3),
    "protanopia": np.array(
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ]
    ),
    "deuteranopia": np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    ),
    "grey": np.tile([0.2126, 0.7152, 0.0722], (3, 1)),
}
COLOURED = ("scatter", "one drift in time", "steadiness", "joint curves", "lens models")


@dataclass(frozen=True)
class Entry:
    """One line of a legend: its colour on white, and all by which it differs but colour."""

    label: str
    colour: str
    mark: tuple[Any, ...]


def styles(element: ElementTree.Element) -> dict[str, str]:
    return dict(re.findall(r"([\w-]+): ([^;]+)", element.get("style", "")))


def on_white(colour: str, opacity: str) -> str:
    share = float(opacity)
    values = [round(share * int(colour[k : k + 2], 16) + (1.0 - share) * 255.0) for k in (1, 3, 5)]
    return "#" + "".join(f"{value:02x}" for value in values)


def entry(handle: ElementTree.Element, label: str, shapes: dict[str, str]) -> Entry:
    """Read a line of the legend: its line, marker and area, each with its shape."""
    colours, mark = [], []
    for one in handle.iter():
        style = styles(one)
        opacity = style.get("opacity", "1")
        if one.tag == f"{SPACE}path" and not one.get("id"):
            fill, stroke = style.get("fill", "#000000"), style.get("stroke", "none")
            mark += [
                "area" if fill != "none" else "line",
                style.get("stroke-dasharray"),
                fill.startswith("url"),
            ]
            colours += [on_white(c, opacity) for c in (stroke, fill) if c.startswith("#")]
        if one.tag == f"{SPACE}use":
            fill, stroke = style.get("fill", "none"), style.get("stroke", "none")
            mark += [shapes[one.get("{http://www.w3.org/1999/xlink}href", "")[1:]], fill == "#ffffff"]
            colours += [c for c in (stroke, fill) if c.startswith("#") and c != "#ffffff"]
    return Entry(label, colours[0] if colours else "#ffffff", tuple(mark))


def legend_of(svg: bytes) -> list[Entry]:
    """Return what the legend of a drawing names, by the comments that hold its text."""
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    root = ElementTree.fromstring(svg, parser)
    (legend,) = (one for one in root.iter(f"{SPACE}g") if one.get("id") == "legend_1")
    handles = [one for one in legend if not one.get("id", "").startswith("text")]
    labels = [one[0].text or "" for one in legend if one.get("id", "").startswith("text")]
    shapes = {one.get("id", ""): one.get("d", "") for one in root.iter(f"{SPACE}path") if one.get("id")}
    return [entry(handle, label.strip(), shapes) for handle, label in zip(handles, labels, strict=True)]


def lab(colour: str, seen_by: str) -> np.ndarray:
    """Return CIE Lab (D65) of an sRGB colour as it is seen."""
    value = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    linear = np.clip(SEEN_BY[seen_by] @ linear, 0.0, 1.0)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    ratio = to_xyz @ linear / (to_xyz @ np.ones(3))
    f = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def distance(one: str, other: str, seen_by: str) -> float:
    return float(np.linalg.norm(lab(one, seen_by) - lab(other, seen_by)))


def test_the_simulation_agrees_with_what_is_known() -> None:
    assert lab("#ffffff", "everybody") == pytest.approx([100.0, 0.0, 0.0], abs=0.01)
    assert lab("#ff0000", "everybody") == pytest.approx([53.2, 80.1, 67.2], abs=0.1)
    # Red and green of one lightness look the same to the colour-blind, blue and orange are not.
    assert distance("#b55b3a", "#70803a", "everybody") > 45.0
    assert distance("#b55b3a", "#70803a", "deuteranopia") < 15.0
    assert distance("#0072b2", "#d55e00", "deuteranopia") > 60.0


@pytest.mark.parametrize("name", [*COLOURED, "residuals", "projection"])
def test_what_a_legend_names_is_distinguished_by_all_readers(name: str) -> None:
    entries = legend_of(draw_svg(DRAWINGS[name], name, "description"))
    assert len(entries) >= (1 if name == "projection" else 2)
    for one, other in itertools.combinations(entries, 2):
        if one.mark != other.mark:
            continue
        for seen_by in SEEN_BY:
            apart = distance(one.colour, other.colour, seen_by)
            assert apart >= APART, f"{one.label!r} and {other.label!r}, {seen_by}: {apart:.0f}"


@pytest.mark.parametrize("name", COLOURED)
def test_no_colour_is_without_its_meaning(name: str) -> None:
    """Every colour of a drawing but greys is that of a line of its legend, whatever its opacity."""
    svg = draw_svg(DRAWINGS[name], name, "description")
    meant = {one.colour for one in legend_of(svg)}
    root = ElementTree.fromstring(svg)
    for element in root.iter():
        for key in ("fill", "stroke"):
            colour = styles(element).get(key, "none")
            if colour.startswith("#") and len({colour[k : k + 2] for k in (1, 3, 5)}) > 1:
                assert colour in meant or on_white(colour, "0.7") in meant, colour


@pytest.mark.parametrize("seen_by", SEEN_BY)
def test_the_scale_of_maps_grows_lighter_for_all_readers(seen_by: str) -> None:
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    lightness = [lab(to_hex(colormaps["viridis"](k / 8)), seen_by)[0] for k in range(9)]
    assert min(np.diff(lightness)) > 4.0


def test_what_an_arm_s_schematic_distinguishes_is_distinguished_by_all_readers() -> None:
    """Lengths that the poses determine and those they do not: by colour, and in grey by dashes and thickness."""
    root = ElementTree.fromstring(draw_svg(arm_schematic, "title", "description"))
    strokes: dict[str, set[tuple[str | None, str | None]]] = {}
    for element in root.iter(f"{SPACE}path"):
        style = styles(element)
        colour = style.get("stroke", "none")
        if colour.startswith("#") and len({colour[k : k + 2] for k in (1, 3, 5)}) > 1:
            strokes.setdefault(colour, set()).add((style.get("stroke-dasharray"), style.get("stroke-width")))
    assert len(strokes) == 2
    determined, undetermined = strokes
    for seen_by in ("everybody", "protanopia", "deuteranopia"):
        assert distance(determined, undetermined, seen_by) >= APART, seen_by
    assert not strokes[determined] & strokes[undetermined]


def test_a_map_of_the_workspace_has_the_colours_of_its_scale_and_marks_without_any() -> None:
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    scale = {to_hex(colormaps["viridis"](k)) for k in range(256)}
    root = ElementTree.fromstring(draw_svg(workspace_map, "title", "description"))
    seen = {
        colour
        for element in root.iter()
        for key in ("fill", "stroke")
        if (colour := styles(element).get(key, "none")).startswith("#")
    }
    coloured = {colour for colour in seen if len({colour[k : k + 2] for k in (1, 3, 5)}) > 1}
    assert coloured
    assert coloured <= scale
    # Marks are white with a dark edge, or dark with a white one: one of both is apart from any colour of the scale.
    for seen_by in SEEN_BY:
        for colour in scale:
            assert max(distance(colour, mark, seen_by) for mark in ("#ffffff", "#222222")) >= 2.0 * APART
