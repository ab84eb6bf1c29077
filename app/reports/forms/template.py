"""A company's template: plain files in `DATA/templates` that change the looks of reports, not their figures.

`report.toml` holds what is written; `logo.svg` or `logo.png` alongside it is drawn in the head of the first page.

    organisation = "Example Metrology"
    address = ["Street 1", "12345 Town"]
    footer = "Accredited by ..."
    accent = "#0b5394"

    [fields]
    "Order" = "4711"

    [certificate]             # what a Digital Calibration Certificate asks for, in addition
    country = "DE"
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal
from xml.etree import ElementTree

from pydantic import BaseModel, ConfigDict, Field, ValidationError

FILE = "report.toml"
MAX_LOGO_BYTES = 2 * 1024 * 1024
_MAX_TOML_BYTES = 64 * 1024
_LOGOS = ("logo.svg", "logo.png")
_PNG = b"\x89PNG\r\n\x1a\n"
_CONTROL = re.compile(r"[\x00-\x1f\x7f]")

Line = Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$")]


class TemplateInvalid(Exception):
    """The files in `DATA/templates` cannot be used; the text names file and field."""


class _Certificate(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    country: Annotated[str, Field(pattern=r"^[A-Z]{2}$")] | None = None
    laboratory_code: Line | None = None
    performed_at: Literal["laboratory", "customer", "laboratoryBranch", "customerBranch", "other"] = "other"
    customer: Line | None = None
    customer_address: Annotated[list[Line], Field(max_length=6)] = []


class _Stated(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    organisation: Line | None = None
    address: Annotated[list[Line], Field(max_length=6)] = []
    footer: Line | None = None
    accent: Annotated[str, Field(pattern=r"^#[0-9a-fA-F]{6}$")] = "#1f4e79"
    fields: Annotated[dict[Line, Line], Field(max_length=20)] = {}
    certificate: _Certificate | None = None


@dataclass(frozen=True, slots=True)
class CompanyTemplate:
    """What a company adds to its reports; `logo` is the bytes of an SVG or PNG file."""

    organisation: str | None = None
    address: tuple[str, ...] = ()
    footer: str | None = None
    accent: str = "#1f4e79"
    fields: Mapping[str, str] = field(default_factory=dict)
    logo: bytes | None = None
    certificate: Mapping[str, Any] | None = None

    @property
    def logo_is_svg(self) -> bool:
        """Whether the logo is an SVG drawing rather than a PNG."""
        return self.logo is not None and not self.logo.startswith(_PNG)

    def document(self) -> dict[str, Any]:
        """Return what is written, as a report's document states it."""
        return {
            "organisation": self.organisation,
            "address": list(self.address),
            "footer": self.footer,
            "fields": dict(self.fields),
            "certificate": None if self.certificate is None else dict(self.certificate),
        }


def read_template(folder: Path) -> CompanyTemplate:
    """Return the template in a folder; the plain one where there is no folder, or nothing in it.

    Raises TemplateInvalid.
    """
    stated = _read_stated(folder / FILE)
    found = [folder / name for name in _LOGOS if (folder / name).is_file()]
    if len(found) > 1:
        raise TemplateInvalid(f"templates/ holds {' and '.join(_LOGOS)}; keep one")
    return CompanyTemplate(
        stated.organisation,
        tuple(stated.address),
        stated.footer,
        stated.accent,
        stated.fields,
        _read_logo(found[0]) if found else None,
        stated.certificate.model_dump() if stated.certificate is not None else None,
    )


def _read_stated(path: Path) -> _Stated:
    if not path.is_file():
        return _Stated()
    try:
        if path.stat().st_size > _MAX_TOML_BYTES:
            raise TemplateInvalid(f"templates/{FILE} is larger than {_MAX_TOML_BYTES} bytes")
        return _Stated.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise TemplateInvalid(f"templates/{FILE} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise TemplateInvalid(f"templates/{FILE} is not UTF-8") from error
    except tomllib.TOMLDecodeError as error:
        raise TemplateInvalid(f"templates/{FILE} is not TOML: {error}") from error
    except ValidationError as error:
        listed = "; ".join(
            f"{'.'.join(map(str, one['loc']))}: {_message(one['type'], one['msg'], one['loc'])}"
            for one in error.errors()[:5]
        )
        raise TemplateInvalid(f"templates/{FILE}: {_CONTROL.sub(' ', listed)}") from error


def _message(kind: str, text: str, place: tuple[str | int, ...]) -> str:
    fields = (_Certificate if place[0] == "certificate" else _Stated).model_fields
    known = {
        "extra_forbidden": f"is not known; known are {', '.join(fields)}",
        "string_type": "must be text in quotes",
        "list_type": "must be a list of lines",
    }
    return known.get(kind, text[:1].lower() + text[1:])


def _read_logo(path: Path) -> bytes:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise TemplateInvalid(f"templates/{path.name} cannot be read: {error.strerror}") from error
    if len(content) > MAX_LOGO_BYTES:
        raise TemplateInvalid(f"templates/{path.name} is larger than {MAX_LOGO_BYTES} bytes")
    if path.suffix == ".png":
        if not content.startswith(_PNG):
            raise TemplateInvalid(f"templates/{path.name} is no PNG file")
        return content
    _check_svg(path.name, content)
    return content


def _check_svg(name: str, content: bytes) -> None:
    """Refuse what an SVG drawing could bring into the HTML form: scripts, handlers, and addresses elsewhere."""
    if b"<!DOCTYPE" in content or b"<!ENTITY" in content:
        raise TemplateInvalid(f"templates/{name} has a document type; save it without")
    try:
        root = ElementTree.fromstring(content)  # noqa: S314 - without a document type no entities expand
    except ElementTree.ParseError as error:
        raise TemplateInvalid(f"templates/{name} is no SVG drawing: {error}") from error
    if root.tag.rpartition("}")[2] != "svg":
        raise TemplateInvalid(f"templates/{name} is no SVG drawing")
    for element in root.iter():
        if str(element.tag).rpartition("}")[2] in ("script", "foreignObject"):
            raise TemplateInvalid(
                f"templates/{name} holds <{str(element.tag).rpartition('}')[2]}>; remove it"
            )
        for key, value in element.attrib.items():
            attribute = key.rpartition("}")[2]
            if attribute.lower().startswith("on"):
                raise TemplateInvalid(f"templates/{name} has the handler {attribute}; remove it")
            if attribute == "href" and not value.startswith(("#", "data:image/png", "data:image/jpeg")):
                raise TemplateInvalid(f"templates/{name} refers to {value[:80]!r}; embed it")
