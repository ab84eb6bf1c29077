"""Letters that the PDF's own fonts lack."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from fontTools.fontBuilder import FontBuilder
from fontTools.pens.ttGlyphPen import TTGlyphPen

from app.reports.forms import CompanyTemplate, RenderingFailed, render_forms
from tests.support.sessions.archived_reports import archived_report, pdf_text


def test_letters_that_no_font_has_are_named_with_the_text_that_holds_them() -> None:
    document = archived_report("repeatability")
    document["inputs"]["robot"]["name"] = "arm \u0378"  # assigned to no letter: no font has it
    document["subject"]["conditions"] = {"operator": "R. \ue000"}  # private: PDF/A allows none
    with pytest.raises(RenderingFailed) as refused:
        render_forms(document, {}, CompanyTemplate())
    assert refused.value.detail.endswith(
        "has U+0378, U+E000, in the robot's name “arm \u0378”; the session's operator “R. \ue000”."
    )
    assert "Install a font" in refused.value.advice


@pytest.mark.skipif(sys.platform != "linux", reason="where a user's fonts are is the system's matter")
def test_letters_that_only_a_font_of_the_computer_has_are_drawn_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "fonts").mkdir()
    _font_of("\u0378", tmp_path / "fonts" / "one.ttf")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    document = archived_report("repeatability")
    plain = render_forms(document, {}, CompanyTemplate())["pdf"]
    document["subject"]["session"]["name"] = "cell \u0378"
    drawn = render_forms(document, {}, CompanyTemplate())["pdf"]
    assert "cell \u0378" in pdf_text(drawn)
    assert b"GridposeTest" in drawn
    assert b"GridposeTest" not in plain
    assert b"<pdfaid:part>3</pdfaid:part>" in drawn


def _font_of(letter: str, path: Path) -> None:
    """Write a font that has one letter, a square."""
    pen = TTGlyphPen(None)
    for to, point in (
        (pen.moveTo, (0, 0)),
        (pen.lineTo, (0, 700)),
        (pen.lineTo, (700, 700)),
        (pen.lineTo, (700, 0)),
    ):
        to(point)
    pen.closePath()
    font = FontBuilder(1000, isTTF=True)
    font.setupGlyphOrder([".notdef", "one"])
    font.setupCharacterMap({ord(letter): "one"})
    font.setupGlyf({".notdef": TTGlyphPen(None).glyph(), "one": pen.glyph()})
    font.setupHorizontalMetrics({".notdef": (800, 0), "one": (800, 0)})
    font.setupHorizontalHeader(ascent=800, descent=-200)
    font.setupNameTable({"familyName": "GridposeTest", "styleName": "Regular", "psName": "GridposeTest"})
    font.setupOS2(sTypoAscender=800, usWinAscent=800, usWinDescent=200)
    font.setupPost()
    font.save(path)
