"""Who measured what, when, where, with which software: the administrative part of a certificate.

What neither the report nor the company's template states is written as not stated, and a statement lists it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from xml.etree.ElementTree import Element

from app.reports.forms.certificate.elements import NOT_STATED, element, named, plain, written
from app.reports.forms.head import measuring_days
from app.reports.forms.wording import Json

UNKNOWN_COUNTRY = "ZZ"
"""A code of ISO 3166-1 that is kept for users; the Unicode CLDR gives it this meaning."""
_NO_CERTIFICATE = (
    "This is the record of a measurement in the form of a Digital Calibration Certificate. It is the certificate of an "
    "accredited laboratory only where the organisation that issues it is accredited and says so itself."
)
_WHOLE = (
    "The form JSON of this report holds every figure and every input. The detached signature covers the SHA-256 of "
    "each form, this one included."
)


def administrative_data(document: Json, json_sha256: str) -> Element:
    """Return the administrative part of a report's document."""
    stated = document["template"].get("certificate") or {}
    organisation, address = document["template"]["organisation"], document["template"]["address"]
    country = stated.get("country")
    customer = stated.get("customer") or organisation
    at_customer = stated.get("customer_address") or (address if not stated.get("customer") else [])
    missing = [
        name
        for name, value in (
            ("country", country),
            ("organisation that measured", organisation),
            ("address of the organisation", address),
            ("customer", customer),
            ("responsible persons", document["signatories"]),
            *_of_item(document),
        )
        if not value
    ]
    return element(
        "dcc:administrativeData",
        element(
            "dcc:dccSoftware",
            named("dcc:software", "Gridpose", plain("dcc:release", document["core_version"])),
        ),
        _references(),
        _core_data(document, json_sha256, country or UNKNOWN_COUNTRY, stated.get("performed_at") or "other"),
        element("dcc:items", _item(document)),
        element(
            "dcc:calibrationLaboratory",
            plain("dcc:calibrationLaboratoryCode", stated["laboratory_code"])
            if stated.get("laboratory_code")
            else None,
            _contact("dcc:contact", organisation, address, country),
        ),
        element("dcc:respPersons", *_persons(document["signatories"])),
        _contact("dcc:customer", customer, at_customer, None if stated.get("customer") else country),
        element("dcc:statements", *(_statement(*lines) for lines in _statements(document, missing))),
    )


def _references() -> Element:
    return element(
        "dcc:refTypeDefinitions",
        named(
            "dcc:refTypeDefinition",
            "Names of figures as the form JSON of a report has them, after the prefix gridpose_",
            plain("dcc:namespace", "gridpose"),
            plain("dcc:link", "docs/reports.md"),
        ),
    )


def _core_data(document: Json, json_sha256: str, country: str, performed_at: str) -> Element:
    begin, end = measuring_days(document)
    return element(
        "dcc:coreData",
        plain("dcc:countryCodeISO3166_1", country),
        plain("dcc:usedLangCodeISO639_1", "en"),
        plain("dcc:mandatoryLangCodeISO639_1", "en"),
        plain("dcc:uniqueIdentifier", document["report_id"]),
        element(
            "dcc:identifications",
            *(
                _identification("calibrationLaboratory", value, name)
                for name, value in (
                    ("session", document["subject"]["session"]["id"]),
                    ("SHA-256 of all inputs", document["inputs_sha256"]),
                    ("SHA-256 of the form JSON", json_sha256),
                    ("fingerprint of the signing key", document["signing_key"]),
                    *document["template"]["fields"].items(),
                )
            ),
        ),
        plain("dcc:beginPerformanceDate", begin.isoformat()),
        plain("dcc:endPerformanceDate", end.isoformat()),
        plain("dcc:performanceLocation", performed_at),
        plain("dcc:issueDate", document["made_at"][:10]),
    )


def _of_item(document: Json) -> Sequence[tuple[str, Any]]:
    robot = document["inputs"]["robot"]
    if document["kind"] == "camera":
        return [("maker and serial number of the camera", None)]
    if robot is None:
        return [("robot", None)]
    return [
        ("the robot's manufacturer", robot["manufacturer"]),
        ("the robot's serial number", robot["serial_number"]),
    ]


def _item(document: Json) -> Element:
    session, robot = document["subject"]["session"], document["inputs"]["robot"]
    if document["kind"] == "camera" or robot is None:
        name = "Camera" if document["kind"] == "camera" else "Robot"
        return named(
            "dcc:item",
            f"{name} of session {session['name']}",
            element("dcc:manufacturer", written("dcc:name", NOT_STATED)),
            element("dcc:identifications", _identification("other", session["id"], "session")),
        )
    serial = robot["serial_number"]
    return named(
        "dcc:item",
        robot["name"],
        element("dcc:manufacturer", written("dcc:name", robot["manufacturer"])),
        plain("dcc:model", robot["model"]) if robot["model"] else None,
        element(
            "dcc:identifications",
            _identification("manufacturer", serial, "serial number") if serial else None,
            _identification("other", robot["id"], "robot"),
        ),
    )


def _identification(issuer: str, value: str, name: str) -> Element:
    return element(
        "dcc:identification",
        plain("dcc:issuer", issuer),
        plain("dcc:value", value),
        written("dcc:name", name),
    )


def _contact(tag: str, name: str | None, address: Sequence[str], country: str | None) -> Element:
    location = element("dcc:location", written("dcc:further", *(address or [NOT_STATED])))
    if country:
        location.append(plain("dcc:countryCode", country))
    return element(tag, written("dcc:name", name), location)


def _persons(signatories: Sequence[Json]) -> list[Element]:
    return [
        element(
            "dcc:respPerson",
            element("dcc:person", written("dcc:name", one["name"])),
            plain("dcc:role", one["role"]) if one["role"] else None,
        )
        for one in signatories or [{"name": NOT_STATED, "role": None}]
    ]


def _statements(document: Json, missing: Sequence[str]) -> list[tuple[str, ...]]:
    days = (
        ()
        if document["subject"]["first_captured_at"]
        else ("the dates are those on which measurements arrived",)
    )
    gaps = (*(f"not stated: {name}" for name in missing), *days)
    return [(_NO_CERTIFICATE,), (_WHOLE,), *([gaps] if gaps else [])]


def _statement(*lines: str) -> Element:
    return element("dcc:statement", written("dcc:declaration", *lines))
