"""No text of a user makes a document that no reader takes."""

from __future__ import annotations

from dataclasses import replace
from itertools import cycle
from xml.etree import ElementTree

import pypdfium2
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.analyses.documents.robot_files.model_files import Model, write_urdf
from app.markup import comment_text, element_text, legal_text, quoted_attribute
from app.printing import draw_sheet, to_pdf, to_svg
from app.reports.camera_plots.residual_map import residuals_svg
from app.reports.drift import drift_svg
from app.reports.scatter import scatter_svg
from core.targets import TargetSpec
from tests.support.image.plotted import ODD_DRIFTS, ODD_FIELDS, ODD_SCATTERS

HOSTILE = {
    "noncharacters": "a\uffff\ufffeb\ufdd0\U0001ffff",
    "control characters": "".join(map(chr, range(32))) + "\x7f\x80\x9f",
    "lone surrogates": "\ud800 \udfff",
    "markup": "<script>&amp;\"'</text>]]><!-- -- --->-",
    "direction": "\u202eabc\u2028\u0000",
    "dollars and backslashes": "$x_1$ \\alpha \\(\\) %s {}",
}


@given(st.text(st.characters(codec=None)))
def test_any_text_comes_out_of_an_xml_parser_as_it_went_in(text: str) -> None:
    expected = legal_text(text)
    document = f"<a b={quoted_attribute(text)}><!--{comment_text(text)}-->{element_text(text)}</a>"
    root = ElementTree.fromstring(document.encode())
    # A parser reads each line end as a line feed, and in an attribute the tabs and line ends that are escaped as such.
    assert (root.text or "") == expected.replace("\r\n", "\n").replace("\r", "\n")
    assert root.attrib["b"] == expected
    assert len(expected) == len(text)


@pytest.mark.parametrize("name", HOSTILE)
def test_plots_of_hostile_names_are_well_formed(name: str) -> None:
    assert_well_formed_plots([HOSTILE[name]], panels=1)


@pytest.mark.slow
def test_odd_plots_of_hostile_names_are_well_formed() -> None:
    """Every odd panel there is, with hostile names in turn."""
    assert_well_formed_plots(list(HOSTILE.values()), panels=len(HOSTILE))


def assert_well_formed_plots(texts: list[str], panels: int) -> None:
    """Draw each kind with so many panels, which have the texts as their names, under each of them as a title."""
    scatters, drifts, fields = (
        list(zip(odd[:panels], cycle(texts))) for odd in (ODD_SCATTERS, ODD_DRIFTS, ODD_FIELDS)
    )
    title = " ".join(texts)
    documents = [
        scatter_svg([replace(one, pose_id=text) for one, text in scatters], title),
        drift_svg([replace(one, pose_id=text) for one, text in drifts], title, 10),
        residuals_svg([replace(one, focus_group=text) for one, text in fields], title),
    ]
    for svg in documents:
        root = ElementTree.fromstring(svg)
        assert all("script" not in element.tag for element in root.iter())


@pytest.mark.parametrize("name", HOSTILE)
def test_sheets_of_hostile_names_are_well_formed(name: str) -> None:
    sheet = draw_sheet(TargetSpec("chessboard", 9, 6, 20.0), name=HOSTILE[name])
    title = ElementTree.fromstring(to_svg(sheet)).findtext("{http://www.w3.org/2000/svg}title")
    assert title
    document = pypdfium2.PdfDocument(to_pdf(sheet))
    assert len(document) == 1
    assert document[0].get_textpage().get_text_range()


@pytest.mark.parametrize("name", HOSTILE)
def test_robots_of_hostile_names_are_well_formed(name: str) -> None:
    text = HOSTILE[name]
    joint = {"a_mm": 1.0, "alpha_deg": 90.0, "d_mm": 2.0, "theta_offset_deg": 0.0, "beta_deg": None}
    document = {
        "residual": {"position_rms_mm": 0.1},
        "chain_residual": None,
        "source": text,
        "session_id": text,
        "joints": [joint],
        "joint_coupling": None,
        "method": text,
        "estimator": text,
        "core_version": text,
        "inputs_sha256": "0",
    }
    root = ElementTree.fromstring(write_urdf(Model(document, text, (text,), (None,), False)).encode())
    assert root.attrib["name"] == legal_text(text)
