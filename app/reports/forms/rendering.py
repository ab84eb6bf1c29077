"""A report's document to its forms, the same bytes for the same document and drawings."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from datetime import datetime
from functools import cache
from importlib import resources
from types import MappingProxyType
from typing import Any, Literal

import jinja2

from app.markup import legal_text
from app.reports.forms.blocks import Block, drawing, facts, heading, leading_notes
from app.reports.forms.camera import camera_blocks
from app.reports.forms.certificate import certificate_xml
from app.reports.forms.figures import figures_csv
from app.reports.forms.head import closing_blocks, opening_blocks
from app.reports.forms.kinematics import kinematics_blocks
from app.reports.forms.missing_letters import FONTS_OF_COMPUTERS, missing_in_words, missing_letters
from app.reports.forms.repeatability import repeatability_blocks
from app.reports.forms.session import session_blocks
from app.reports.forms.template import CompanyTemplate
from app.reports.forms.wording import worded

FORMAT = "gridpose-report"
FORMAT_VERSION = 1
_PDF_STANDARDS: list[Literal["a-3a", "ua-1"]] = ["a-3a", "ua-1"]
_PAPERS = {"a4": ("a4", 680.0), "letter": ("us-letter", 630.0)}
"""typst's name, and how high a drawing may be on a page, pt."""
_KINDS = {
    "repeatability": (
        "Pose repeatability and accuracy by ISO 9283:1998",
        "repeatability",
        repeatability_blocks,
    ),
    "kinematics": ("Identified kinematics", "dh", kinematics_blocks),
    "camera": ("Camera calibration", "intrinsics", camera_blocks),
}
_CAPTIONS = {
    "scatter": "Cycles of each pose about their mean, in three projections.",
    "drift": "Position of each pose over the cycles, with the means of blocks of ten cycles.",
    "steadiness": "Motion that all poses share over the cycles, and each pose's own.",
    "joint_curves": "What each joint turns by beyond its stated angle, with the 95 % band, and the angles visited.",
    "residuals": "Residuals over the image: what the camera model leaves over, by place.",
    "projection": "Projection uncertainty of points at infinity over the image, and how many points each part has.",
}
_MISSING_ADVICE = (
    "Install a font that has these letters on the service's computer (Noto Sans CJK, Noto Sans Thai or Noto Color "
    "Emoji), or change the text to letters that the fonts have; then order the report again."
)
_WIDTH_PT = {"a4": 493.0, "letter": 510.0}


class RenderingFailed(Exception):
    """The PDF could not be drawn from these data: why, and what to do."""

    def __init__(self, detail: str, advice: str) -> None:
        super().__init__(detail)
        self.detail, self.advice = detail, advice


def render_forms(
    document: Mapping[str, Any],
    drawings: Mapping[str, Sequence[str]],
    template: CompanyTemplate,
    exports: Mapping[str, str] = MappingProxyType({}),
) -> dict[str, bytes]:
    """Return the forms json, html, pdf, csv of a report, and xml of one that can be a calibration certificate.

    `drawings` are the pages of each drawing, SVG documents, by its name; `exports` text files by name that the PDF
    carries. Raises RenderingFailed.
    """
    text = (json.dumps(document, ensure_ascii=False, indent=1, allow_nan=False) + "\n").encode()
    json_sha256 = hashlib.sha256(text).hexdigest()
    head = _head(document, template, json_sha256)
    blocks = report_blocks(document, drawings)
    certificate = certificate_xml(document, json_sha256)
    return {
        "json": text,
        "html": _html(head, blocks, template),
        "pdf": _pdf(
            head,
            blocks,
            template,
            {"attached": text.decode(), "exports": json.dumps(dict(exports))},
            document,
        ),
        "csv": figures_csv(document),
        **({} if certificate is None else {"xml": certificate}),
    }


def report_blocks(document: Mapping[str, Any], drawings: Mapping[str, Sequence[str]]) -> list[Block]:
    """Return all sections of a report, in their order."""
    stated = document["template"]["fields"]
    document = worded(document)
    if document["kind"] == "session":
        body = session_blocks(document["analyses"], document["refusals"], document["inputs"])
    else:
        _, analysis, blocks_of = _KINDS[document["kind"]]
        body = blocks_of(document["analyses"][analysis], document["inputs"])
    return [
        *leading_notes(document["analyses"].get("repeatability", {"warnings": ()})),
        *([heading("Order"), facts(list(stated.items()))] if stated else []),
        *opening_blocks(document),
        *body,
        *closing_blocks(document),
        *_drawings(
            {name: pages for name, pages in drawings.items() if name not in _without_figures(document)}
        ),
    ]


def _without_figures(document: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the drawings that would show no figure of the session's: where nothing was repeated, the scatter."""
    poses = document["analyses"].get("repeatability", {"poses": ()})["poses"]
    return () if any(pose["cycles"] > 1 for pose in poses) else ("scatter",)


def _drawings(drawings: Mapping[str, Sequence[str]]) -> list[Block]:
    found = [
        drawing(svg, f"{caption}{part}", f"{caption}{part} The tables of this report hold its figures.")
        for name, caption in _CAPTIONS.items()
        for pages in [drawings.get(name, ())]
        for number, svg in enumerate(pages, 1)
        for part in [f" Page {number} of {len(pages)}." if len(pages) > 1 else ""]
    ]
    return [heading("Annex: drawings"), *found] if found else []


def _head(document: Mapping[str, Any], template: CompanyTemplate, json_sha256: str) -> dict[str, Any]:
    subtitle = _KINDS[document["kind"]][0] if document["kind"] in _KINDS else "Measurement session"
    return {
        "id": document["report_id"],
        "title": document["title"],
        "subtitle": f"{subtitle} · {document['subject']['session']['name']}",
        "made_on": document["made_at"][:10],
        "organisation": template.organisation or "",
        "address": list(template.address),
        "footer": template.footer,
        "accent": template.accent,
        "json_sha256": json_sha256,
    }


def _html(head: Mapping[str, Any], blocks: list[Block], template: CompanyTemplate) -> bytes:
    drawn = [
        {**one, "uri": _uri("image/svg+xml", one["svg"].encode())} if one["block"] == "drawing" else one
        for one in blocks
    ]
    logo = None
    if template.logo is not None:
        logo = _uri("image/svg+xml" if template.logo_is_svg else "image/png", template.logo)
    return _page().render(report=head, blocks=drawn, logo_uri=logo).encode()


def _uri(media_type: str, content: bytes) -> str:
    return f"data:{media_type};base64,{base64.b64encode(content).decode()}"


@cache
def _page() -> jinja2.Template:
    source = resources.files(__package__).joinpath("report.html.j2").read_text(encoding="utf-8")
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    return environment.from_string(source)


@cache
def _typst_source() -> bytes:
    return resources.files(__package__).joinpath("report.typ").read_bytes()


def _pdf(
    head: Mapping[str, Any],
    blocks: list[Block],
    template: CompanyTemplate,
    carried: Mapping[str, str],
    document: Mapping[str, Any],
) -> bytes:
    import typst  # 47 MB that only the process that draws loads

    paper, height_pt = _PAPERS[document["paper"]]
    width_pt = _WIDTH_PT[document["paper"]]
    drawn = [
        {**one, "height_pt": _drawn_height(one["svg"], width_pt, height_pt)}
        if one["block"] == "drawing"
        else one
        for one in blocks
    ]
    values = {
        **head,
        "paper": paper,
        "logo": None if template.logo is None else list(template.logo),
        "logo_is_svg": template.logo_is_svg,
        "blocks": drawn,
    }
    inputs = {"report": legal_text(json.dumps(values, ensure_ascii=False)), **carried}

    def compiled(*fonts: str) -> bytes:
        return bytes(
            typst.compile(
                _typst_source(),
                format="pdf",
                sys_inputs={**inputs, "fonts": json.dumps(fonts)},
                ignore_system_fonts=not fonts,
                pdf_standards=[*_PDF_STANDARDS],
                timestamp=datetime.fromisoformat(document["made_at"]),
            )
        )

    try:
        try:
            return compiled()
        except typst.TypstError as error:
            # Only then: the same document gives the same bytes on every computer wherever it can.
            if not missing_letters(error.diagnostic):
                raise
            return compiled(*FONTS_OF_COMPUTERS)
    except typst.TypstError as error:
        letters = missing_letters(error.diagnostic)
        if letters:
            raise RenderingFailed(missing_in_words(document, letters), _MISSING_ADVICE) from error
        raise RenderingFailed(str(error), "Check the logo in DATA/templates.") from error


_SIZE = re.compile(r'<svg[^>]*\bviewBox="0 0 ([\d.]+) ([\d.]+)"')


def _drawn_height(svg: str, width_pt: float, most_pt: float) -> float:
    """Return how high a drawing is at the page's width, pt, and at most so high that it fits a page."""
    found = _SIZE.search(svg)
    if found is None:
        return most_pt / 2
    return min(float(found[2]) * min(width_pt / float(found[1]), 1.0), most_pt)
