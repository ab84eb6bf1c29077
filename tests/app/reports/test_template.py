"""A company's template: what is right is taken, what is not is named by file and field."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.reports.forms import CompanyTemplate, TemplateInvalid, read_template

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
