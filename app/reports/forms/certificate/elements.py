"""Elements of a Digital Calibration Certificate: text, and quantities in the Digital System of Units (D-SI).

Tags are written with the prefixes that the root declares: `dcc:` and `si:`. Numbers are written in full, as the form
JSON has them.

References: Physikalisch-Technische Bundesanstalt, DCC 3.2.0 (2023) and D-SI 2.1.0 (2022), XML schemas.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree.ElementTree import Element

from app.markup import legal_text
from app.reports.forms.blocks import NORMAL_95, Block
from app.reports.forms.figures import unit_of

NOT_STATED = "not stated"
_UNITS = {
    "mm": r"\milli\metre",
    "degree": r"\degree",
    "kg": r"\kilogram",
    "%": r"\percent",
    "degree Celsius": r"\degreecelsius",
    "min": r"\minute",
    "px": r"\one",  # a number of pixels is a count (SI Brochure, 9th edition, 5.4.7)
    "": r"\one",
}


def element(tag: str, *children: Element | None, text: str | None = None, **attributes: str) -> Element:
    """Return an element with its children, those that are None excepted."""
    made = Element(tag, attributes)
    made.text = text
    made.extend([child for child in children if child is not None])
    return made


def stated(text: Any) -> str:
    """Return text as the schema takes it: without spaces at its ends, and never empty."""
    return " ".join(legal_text(str(text if text is not None else "")).split()) or NOT_STATED


def plain(tag: str, text: Any) -> Element:
    """Return an element with nothing but text."""
    return element(tag, text=stated(text))


def written(tag: str, *lines: Any) -> Element:
    """Return an element of English text, a `content` for each line."""
    return element(tag, *(element("dcc:content", text=stated(line), lang="en") for line in lines))


def named(tag: str, name: str, *children: Element | None, **attributes: str) -> Element:
    """Return an element that begins with its name."""
    return element(tag, written("dcc:name", name), *children, **attributes)


def coverage_factor(degrees_of_freedom: float | None) -> float:
    """Return k of 95 %, of the t distribution (JCGM 100:2008, G.3.2); the normal one where none are known."""
    if degrees_of_freedom is None:
        return NORMAL_95
    from scipy.special import stdtrit  # certificates are few, and what serves them need not load it

    return float(stdtrit(degrees_of_freedom, 0.975))


def figure(
    name: str,
    key: str,
    value: float | None,
    *,
    u: float | None = None,
    k: float = NORMAL_95,
    interval: Sequence[float] | None = None,
    level: float = 0.95,
) -> list[Element]:
    """Return a figure as a quantity; none where it is not known.

    `key` is its name in the form JSON, which ends with its unit. With an interval and a standard uncertainty `u` it has
    a coverage interval, with `u` alone the expanded uncertainty k u. An interval alone is a quantity of its own: the
    schema has no place for one without a standard uncertainty.
    """
    if value is None:
        return []
    unit = unit_in_si(key)
    uncertainty = None
    if u is not None and interval is not None:
        uncertainty = element(
            "si:coverageInterval",
            element("si:standardUnc", text=repr(u)),
            element("si:intervalMin", text=repr(interval[0])),
            element("si:intervalMax", text=repr(interval[1])),
            element("si:coverageProbability", text=repr(level)),
        )
    elif u is not None:
        uncertainty = element(
            "si:expandedUnc",
            element("si:uncertainty", text=repr(k * u)),
            element("si:coverageFactor", text=repr(k)),
            element("si:coverageProbability", text=repr(level)),
        )
    real = element(
        "si:real", element("si:value", text=repr(value)), element("si:unit", text=unit), uncertainty
    )
    found = [named("dcc:quantity", name, real, refType=_reference(key))]
    if u is None and interval is not None:
        ends = dict(zip(("lower", "upper"), interval, strict=True))
        found += figures(
            f"{name}, ends of the {100.0 * level:g} % interval", f"{key}.interval", ends, unit=unit
        )
    return found


def figures(
    name: str, key: str, values: Mapping[str, float | None], *, unit: str | None = None
) -> list[Element]:
    """Return figures, by their names in the form JSON, as one quantity; none where any is not known.

    Each name ends with its unit, unless all have one `unit`.
    """
    known = [value for value in values.values() if value is not None]
    if len(known) < len(values) or not known:
        return []
    listed = element(
        "si:realListXMLList",
        element("si:labelXMLList", text=" ".join(values)),
        element("si:valueXMLList", text=" ".join(map(repr, known))),
        element("si:unitXMLList", text=" ".join(unit or unit_in_si(label) for label in values)),
    )
    return [named("dcc:quantity", name, listed, refType=_reference(key))]


def unit_in_si(key: str) -> str:
    """Return the unit that a figure's name ends with, as D-SI writes it."""
    return _UNITS[unit_of(key)]


def result(name: str, data: Sequence[Element], *description: str) -> list[Element]:
    """Return a result with its quantities; none without any."""
    if not data:
        return []
    said = written("dcc:description", *description) if description else None
    return [named("dcc:result", name, said, element("dcc:data", *data))]


def sections(blocks: Sequence[Block], headings: Sequence[str]) -> list[Element]:
    """Return those sections of a report that begin with one of these words, as results of text."""
    found: list[Element] = []
    title, lines = "", list[str]()
    for block in [*blocks, {"block": "heading", "text": ""}]:
        if block["block"] != "heading":
            lines += _lines(block)
            continue
        if lines and title.startswith(tuple(headings)):
            found += result(title, [written("dcc:text", *lines)])
        title, lines = block["text"], []
    return found


def _lines(block: Block) -> list[str]:
    if block["block"] == "paragraph":
        return [block["text"]]
    if block["block"] == "notes":
        return list(block["items"])
    if block["block"] == "facts":
        return [f"{label}: {value}" for label, value in block["rows"]]
    if block["block"] == "table":
        named_cells = [
            "; ".join(f"{column}: {cell}" for column, cell in zip(block["columns"], row, strict=True))
            for row in block["rows"]
        ]
        return [f"{block['caption']}:", *named_cells]
    return []


def _reference(key: str) -> str:
    return f"gridpose_{key}"
