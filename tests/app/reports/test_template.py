"""A company's template: what is right is taken, what is not is named by file and field; the fonts of its computer,
where those of the PDF lack a letter; and names that are long or read from right to left.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pypdfium2
import pytest
from fontTools.fontBuilder import FontBuilder
from fontTools.pens.ttGlyphPen import TTGlyphPen

from app.reports.forms import (
    CompanyTemplate,
    RenderingFailed,
    TemplateInvalid,
    read_template,
    render_forms,
    rendering,
)
from app.reports.forms.missing_letters import FONTS_OF_COMPUTERS
from tests.support.sessions.archived_reports import archived_report, pdf_text

SVG = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 9 9">{}</svg>'


def test_without_files_the_template_is_the_plain_one(tmp_path: Path) -> None:
    assert read_template(tmp_path / "templates") == CompanyTemplate()


def test_what_is_stated_is_taken(tmp_path: Path) -> None:
    text = 'organisation = "E"\naddress = ["S 1"]\naccent = "#0b5394"\n[fields]\n"Order" = "4711"\n'
    (tmp_path / "report.toml").write_text(text, encoding="utf-8")
    (tmp_path / "logo.svg").write_text(SVG.format("<path/>"), encoding="utf-8")
    found = read_template(tmp_path)
    assert (found.organisation, found.address, found.fields) == ("E", ("S 1",), {"Order": "4711"})
    assert found.logo_is_svg


@pytest.mark.parametrize(
    ("name", "content", "named"),
    [
        ("report.toml", 'colour = "red"', "colour"),
        ("report.toml", "organisation = 5", "organisation"),
        ("report.toml", 'accent = "red"', "accent"),
        ("report.toml", "organisation = ", "TOML"),
        ("report.toml", '[certificate]\ncountry = "Germany"', r"certificate\.country.*A-Z"),
        ("report.toml", '[certificate]\ncity = "Ulm"', r"certificate\.city.*laboratory_code"),
        ("logo.png", "no png", "logo.png"),
        ("logo.svg", "<svg", "no SVG"),
        ("logo.svg", SVG.format("<script/>"), "script"),
        ("logo.svg", SVG.format('<g onload="x()"/>'), "onload"),
        ("logo.svg", SVG.format('<image href="http://elsewhere/x"/>'), "elsewhere"),
        ("logo.svg", '<!DOCTYPE svg [<!ENTITY a "b">]><svg/>', "document type"),
    ],
)
def test_an_error_names_file_and_field(tmp_path: Path, name: str, content: str, named: str) -> None:
    (tmp_path / name).write_text(content, encoding="utf-8")
    with pytest.raises(TemplateInvalid, match=named) as caught:
        read_template(tmp_path)
    assert name in str(caught.value)


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
    # A family that no computer has: one that has it would draw with its own.
    monkeypatch.setattr(rendering, "FONTS_OF_COMPUTERS", (*FONTS_OF_COMPUTERS, "Known"))
    _font_of("\u0378", tmp_path / "fonts" / "one.ttf", "Known")
    _font_of("\u0379", tmp_path / "fonts" / "other.ttf", "Unknown")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    document = archived_report("repeatability")
    plain = render_forms(document, {}, CompanyTemplate())["pdf"]
    document["subject"]["session"]["name"] = "cell \u0378"
    drawn = render_forms(document, {}, CompanyTemplate())["pdf"]
    assert "cell \u0378" in pdf_text(drawn)
    assert b"GridposeTest" in drawn
    assert b"GridposeTest" not in plain
    assert b"<pdfaid:part>3</pdfaid:part>" in drawn
    document["subject"]["session"]["name"] = "cell \u0379"
    with pytest.raises(RenderingFailed, match="has U\\+0379, in the session's name"):  # it might be a blank
        render_forms(document, {}, CompanyTemplate())


def _font_of(letter: str, path: Path, family: str) -> None:
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
    font.setupNameTable({"familyName": family, "styleName": "Regular", "psName": "GridposeTest"})
    font.setupOS2(sTypoAscender=800, usWinAscent=800, usWinDescent=200)
    font.setupPost()
    font.save(path)


def test_no_name_without_spaces_leaves_the_page_or_covers_another_text() -> None:
    document = archived_report("repeatability")
    long_name = "Ω" * 90 + "x" * 110
    document["title"] = f"Session {long_name}"
    document["subject"]["session"]["name"] = long_name
    document["inputs"]["robot"] = {**(document["inputs"]["robot"] or {}), "serial_number": "S" * 100}
    pdf = pypdfium2.PdfDocument(render_forms(document, {}, CompanyTemplate())["pdf"])
    for page in pdf:
        letters = page.get_textpage()
        boxes = [letters.get_charbox(k) for k in range(letters.count_chars())]
        assert max(right for _, _, right, _ in boxes) < page.get_width() - mm(17.0)
        (at, count) = letters.search(document["report_id"]).get_next()
        left, low = boxes[at][0], boxes[at][1]
        rest = [box for box in boxes[:at] + boxes[at + count :] if box[2] > box[0]]
        assert not [box for box in rest if box[2] > left and box[1] < low + mm(2.0) and box[3] > low]


def mm(length: float) -> float:
    """Return a length in points."""
    return length * 72.0 / 25.4


def test_the_date_of_a_report_does_not_turn_round_after_a_name_from_right_to_left() -> None:
    document = archived_report("repeatability")
    document["subject"]["session"]["name"] = "خلية"
    page = pypdfium2.PdfDocument(render_forms(document, {}, CompanyTemplate())["pdf"])[0]
    head = page.get_textpage().get_text_range().partition("Subject")[0]
    assert document["made_at"][:10] in head


def test_a_floor_that_is_not_known_has_no_unit() -> None:
    document = archived_report("repeatability")
    for pose in document["analyses"]["repeatability"]["poses"]:
        pose["noise_floor"] = dict.fromkeys(pose["noise_floor"])
    text = render_forms(document, {}, CompanyTemplate())["html"].decode()
    assert "<dt>its noise floor</dt><dd>not known</dd>" in text
