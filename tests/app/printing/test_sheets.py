"""Printed targets, rasterised: found by the detectors, true to scale, with rulers and words where they should be."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from xml.etree import ElementTree

import numpy as np
import pypdfium2
import pytest

from app.printing import PAPER_SIZES_MM, Paper, Sheet, draw_sheet, sheet_id_of, to_pdf, to_svg
from app.printing.outlines import pattern_outlines
from app.printing.sheet import MAX_ORIGIN_DOT_RATIO
from core import TargetSpec
from core.errors import InvalidArgument, InvalidTarget
from core.targets.detection import detect
from tests.app.printing.sheets import CASES, Case, Raster, pdf_raster, svg_raster

CHESSBOARD = TargetSpec("chessboard", 9, 6, 25.0)


def sheet_of(case: Case) -> Sheet:
    return draw_sheet(case.target, case.paper, origin_dot=case.origin_dot, marks=case.marks)


@pytest.mark.slow
@pytest.mark.parametrize("rasterise", [pdf_raster, svg_raster])
@pytest.mark.parametrize("case", CASES, ids=str)
def test_every_kind_is_found_on_its_sheet_at_its_true_scale(
    case: Case, rasterise: Callable[[Sheet, float], Raster]
) -> None:
    sheet = sheet_of(case)
    # no whole number of pixels to a millimetre, so that rounding would show
    raster = rasterise(sheet, 30.3 if case.paper == "A0" else 80.7)
    found = detect(raster.as_scanned, case.target)
    assert len(found) == case.target.size
    assert found.labelling == case.labelling
    expected = found.points_target[:, :2] + sheet.origin
    places = raster.on_paper(found.points_px)
    assert np.abs(places - expected).max() < max(0.01, raster.rounding_px * raster.mm_per_px.max())
    pitch = np.linalg.lstsq(np.column_stack([expected, np.ones(len(places))]), places, rcond=None)[0][:2]
    np.testing.assert_allclose(pitch, np.eye(2), atol=2e-4)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_nothing_is_printed_near_the_edge_and_the_target_has_white_around_it(case: Case) -> None:
    sheet = sheet_of(case)
    places = np.array(
        [values[k : k + 2] for path in sheet.outlines for _, values in path for k in range(0, len(values), 2)]
    )
    assert places.min() >= 5.0 - 1e-9
    assert np.all(places.max(axis=0) <= np.array([sheet.paper.width_mm, sheet.paper.height_mm]) - 5.0 + 1e-9)
    raster = pdf_raster(sheet, 50.3)
    left, bottom = sheet.along_y.line, sheet.along_x.line
    rows, columns = np.nonzero(raster.levels < 128)
    x, y = raster.on_paper(np.stack([columns, rows], axis=1)).T
    inside = (x > left + 0.5) & (y < bottom - 0.5)
    quiet = 0.25 * case.target.pitch_mm - 0.6  # a pixel
    assert x[inside].min() > left + quiet
    assert y[inside].max() < bottom - quiet


@pytest.mark.slow
@pytest.mark.parametrize("rasterise", [pdf_raster, svg_raster])
def test_rulers_stand_where_they_say(rasterise: Callable[[Sheet, float], Raster]) -> None:
    sheet = draw_sheet(CHESSBOARD)
    raster = rasterise(sheet, 151.7)

    def marks(levels: np.ndarray, mm_per_px: float) -> np.ndarray:
        """Return the centres of dark runs along a line, mm from its beginning."""
        ink = 255.0 - levels
        runs = np.flatnonzero(ink > 40)
        runs = np.split(runs, np.flatnonzero(np.diff(runs) > 1) + 1)
        around = [np.arange(run[0] - 1, run[-1] + 2) for run in runs]
        return (np.array([np.average(k, weights=ink[k]) for k in around]) + 0.5) * mm_per_px

    x, y = raster.mm_per_px
    row, column = round((sheet.along_x.line + 0.7) / y), round((sheet.along_y.line - 0.7) / x)
    corner = round(10.0 / x)  # left of it are the other ruler's figures, below that row this one's
    along_x = marks(raster.levels[row, corner:], x) + corner * x
    along_y = marks(raster.levels[: row - 5, column], y)
    for found, ruler in ((along_x, sheet.along_x), (along_y, sheet.along_y)):
        np.testing.assert_allclose(found - ruler.start, np.arange(0.0, ruler.length + 1.0, 5.0), atol=0.02)
    assert sheet.along_x.length == 270.0
    assert sheet.along_y.length == 180.0


def test_the_sheet_says_what_it_is() -> None:
    board = TargetSpec("charuco", 5, 8, 28.0, 20.0, "DICT_6X6_250", legacy_layout=True)
    sheet = draw_sheet(board, name="Cell 7 (left) \\ Größe Ω <&>")
    pdf = to_pdf(sheet)
    text = pypdfium2.PdfDocument(pdf)[0].get_textpage().get_text_range()
    text = " ".join(text.split())
    assert f"{sheet.sheet_id}: charuco 5 x 8 inner corners" in text
    for words in (
        "28 mm",
        "marker 20 mm",
        "DICT_6X6_250",
        "legacy layout",
        "100 %",
        "Cell 7 (left) \\ Größe",
    ):
        assert words in text
    assert " 250" in text
    assert pypdfium2.PdfDocument(pdf).get_metadata_value("Title") == sheet.title
    assert b"/PrintScaling /None" in pdf
    root = ElementTree.fromstring(to_svg(sheet))
    title, desc = (root.find(f"{{http://www.w3.org/2000/svg}}{tag}").text for tag in ("title", "desc"))
    assert title == sheet.title
    assert "never fitted to the page" in desc
    # Letters are drawn: there is ink where the first line stands.
    raster = svg_raster(sheet, 100.0)
    first = sheet.texts[0]
    u, v = (round(place / size) for place, size in zip((first.x, first.y), raster.mm_per_px, strict=True))
    assert np.count_nonzero(raster.levels[v - 8 : v, u : u + 300] < 128) > 100


def test_the_same_sheet_is_the_same_bytes_and_has_the_same_id() -> None:
    assert to_pdf(draw_sheet(CHESSBOARD)) == to_pdf(draw_sheet(CHESSBOARD))
    assert to_svg(draw_sheet(CHESSBOARD)) == to_svg(draw_sheet(CHESSBOARD))
    sheet_id = sheet_id_of(CHESSBOARD)
    assert re.fullmatch(r"gp-[0-9a-f]{8}", sheet_id)
    # On paper, it is printed for good: this one may never change.
    assert sheet_id == "gp-5d49aa3e"
    uncertain = TargetSpec("chessboard", 9, 6, 25.0, pitch_standard_uncertainty_mm=0.1)
    assert sheet_id_of(uncertain) == sheet_id
    others = {
        sheet_id_of(CHESSBOARD, marks=True),
        sheet_id_of(TargetSpec("chessboard", 9, 6, 25.1)),
        sheet_id_of(TargetSpec("circles", 9, 6, 25.0)),
        sheet_id_of(TargetSpec("circles", 9, 6, 25.0), origin_dot=1.5),
    }
    assert len(others | {sheet_id}) == 5


def test_the_id_is_one_of_what_is_printed() -> None:
    """Whatever two descriptions are: one id where they have the same ink, and two where they have not."""
    charuco = [
        TargetSpec("charuco", columns, rows, 20.0, 15.0, dictionary, legacy)
        for columns, rows in ((9, 6), (9, 7), (20, 6))  # 35, 40 and 73 markers
        for dictionary in (
            "DICT_5X5_50",
            "DICT_5X5_100",
            "DICT_5X5_1000",
            "DICT_6X6_100",
            "DICT_APRILTAG_36h11",
            "DICT_APRILTAG_36H11",
        )
        for legacy in (False, True)
        if (columns, dictionary) != (20, "DICT_5X5_50")
    ]
    dots = [
        TargetSpec(kind, 7, 5, 20.0, marker_mm)
        for kind, usual in (("circles", 10.0), ("asymmetric_circles", 10.0 * math.sqrt(2.0)))
        for marker_mm in (None, usual, 8.0)
    ]
    grids = [
        TargetSpec("aprilgrid", 5, 4, 40.0, marker_mm, dictionary)
        for marker_mm in (30.0, 31.0)
        for dictionary in (None, "DICT_APRILTAG_36h11")
    ]
    targets = [*charuco, *dots, *grids, CHESSBOARD, TargetSpec("chessboard", 9, 6, 25)]
    by_ink: dict[object, set[str]] = {}
    for target in targets:
        by_ink.setdefault(pattern_outlines(target), set()).add(sheet_id_of(target))
    boards = 3 * 3 + 3  # three sizes of three families; the old layout differs where squares have eight rows
    assert len(by_ink) == boards + 4 + 2 + 1
    assert all(len(ids) == 1 for ids in by_ink.values())
    assert len(set.union(*by_ink.values())) == len(by_ink)


def test_the_page_is_the_paper() -> None:
    small = TargetSpec("chessboard", 4, 3, 10.0)
    for name, (short, long) in PAPER_SIZES_MM.items():
        page = pypdfium2.PdfDocument(to_pdf(draw_sheet(small, name)))[0]
        assert sorted(v * 25.4 / 72.0 for v in page.get_size()) == pytest.approx([short, long], abs=1e-3)
    assert draw_sheet(TargetSpec("chessboard", 9, 4, 20.0)).paper == Paper("A4", upright=False)
    assert draw_sheet(TargetSpec("chessboard", 4, 9, 20.0)).paper == Paper("A4", upright=True)


def test_a_target_too_large_is_refused_with_its_paper_and_its_pitch() -> None:
    with pytest.raises(InvalidArgument, match="300 x 210 mm, too large for A4") as refused:
        draw_sheet(TargetSpec("chessboard", 9, 6, 30.0))
    advice = refused.value.advice or ""
    assert advice.startswith("Print on A3, or use a pitch of ")
    pitch = float(re.search(r"pitch of ([\d.]+) mm", advice)[1])  # type: ignore[index]
    draw_sheet(TargetSpec("chessboard", 9, 6, pitch))
    with pytest.raises(InvalidArgument):
        draw_sheet(TargetSpec("chessboard", 9, 6, pitch + 0.1))
    draw_sheet(TargetSpec("chessboard", 9, 6, 30.0), "A3")
    with pytest.raises(InvalidArgument) as refused:
        draw_sheet(TargetSpec("chessboard", 200, 100, 30.0), "A0")
    assert "Print on" not in (refused.value.advice or "")


@pytest.mark.parametrize("diameter_mm", [4.0, 10.0])
@pytest.mark.parametrize("origin_dot", [1.3, MAX_ORIGIN_DOT_RATIO])
def test_every_dot_allowed_at_the_origin_identifies_it(diameter_mm: float, origin_dot: float) -> None:
    target = TargetSpec("circles", 8, 6, 20.0, diameter_mm)
    found = detect(pdf_raster(draw_sheet(target, origin_dot=origin_dot), 50.3).as_scanned, target)
    assert (len(found), found.labelling) == (target.size, "absolute")


def test_what_cannot_be_printed_is_refused_with_advice() -> None:
    dots = TargetSpec("circles", 9, 6, 20.0)
    for refused in (
        lambda: draw_sheet(CHESSBOARD, "A5"),
        lambda: draw_sheet(CHESSBOARD, origin_dot=1.5),
        lambda: draw_sheet(dots, marks=True),
        lambda: draw_sheet(dots, origin_dot=1.1),  # not distinguished from the others
        lambda: draw_sheet(dots, origin_dot=2.5),  # not taken for one of them
        lambda: draw_sheet(TargetSpec("circles", 9, 6, 20.0, 14.0), origin_dot=1.6),  # meets its neighbours
        lambda: draw_sheet(TargetSpec("circles", 9, 6, 20.0, 17.0), origin_dot=1.3),  # no room for any
    ):
        with pytest.raises(InvalidArgument):
            refused()
    with pytest.raises(InvalidTarget, match="marker_mm"):
        draw_sheet(TargetSpec("charuco", 9, 6, 20.0, 25.0, "DICT_6X6_250"))
    for target, field in (
        (TargetSpec("circles", 9, 6, 20.0, 25.0), "marker_mm"),
        (TargetSpec("circles", 9, 6, 20.0, 0.001), "marker_mm"),
        (TargetSpec("chessboard", 9, 6, 20.0, dictionary="DICT_6X6_250"), "dictionary"),
        (TargetSpec("chessboard", 9, 6, 1e-4), "pitch_mm"),
        (TargetSpec("circles", 9, 6, 0.49), "pitch_mm"),
    ):
        with pytest.raises(InvalidTarget) as invalid:
            draw_sheet(target)
        assert invalid.value.field == field
    draw_sheet(TargetSpec("chessboard", 9, 6, 0.5))
