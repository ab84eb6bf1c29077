"""A report's document as the XML of a Digital Calibration Certificate, the same bytes for the same document."""

from __future__ import annotations

from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from app.reports.forms.certificate.administrative import administrative_data
from app.reports.forms.certificate.elements import element, figure, named, plain, written
from app.reports.forms.certificate.parameters import camera_results, kinematics_results
from app.reports.forms.certificate.repeatability import conformity, repeatability_results
from app.reports.forms.wording import Json, worded, words

_VERSION = "3.2.0"
_NAMESPACES = {
    "xmlns:dcc": "https://ptb.de/dcc",
    "xmlns:si": "https://ptb.de/si",
    "xmlns:xsi": "http://www.w3.org/2001/XMLSchema-instance",
    "xsi:schemaLocation": f"https://ptb.de/dcc https://ptb.de/dcc/v{_VERSION}/dcc.xsd",
    "schemaVersion": _VERSION,
}
_KINDS = {
    "repeatability": ("Pose repeatability and accuracy", "repeatability", repeatability_results),
    "kinematics": ("Identified kinematics", "dh", kinematics_results),
    "camera": ("Camera calibration", "intrinsics", camera_results),
}
_METHODS = {
    "repeatability": "Cycles of stationary poses: scatter and mean of each, and the share of the instrument's noise",
    "kinematics": "Identification of Denavit-Hartenberg parameters from poses of the flange",
    "camera": "Calibration of one camera from images of a printed grid",
}
_CONDITIONS = (
    ("Load", "load_kg"),
    ("Speed, of the rated", "speed_percent"),
    ("Temperature", "temperature_c"),
    ("Warm-up", "warm_up_min"),
)


def certificate_xml(document: Json, json_sha256: str) -> bytes | None:
    """Return the certificate; None for a kind of report that is not the measurement of one item.

    `json_sha256` is the hash of the form JSON.
    """
    if document["kind"] not in _KINDS:
        return None
    document = worded(document)
    root = element(
        "dcc:digitalCalibrationCertificate", administrative_data(document, json_sha256), _measured(document)
    )
    root.attrib.update(_NAMESPACES)
    ElementTree.indent(root, " ")
    return ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"


def _measured(document: Json) -> Element:
    title, analysis, results_of = _KINDS[document["kind"]]
    found, inputs = document["analyses"][analysis], document["inputs"]
    is_iso = document["kind"] == "repeatability"
    return element(
        "dcc:measurementResults",
        named(
            "dcc:measurementResult",
            title,
            element(
                "dcc:usedMethods",
                named(
                    "dcc:usedMethod",
                    _METHODS[document["kind"]],
                    written("dcc:description", f"Estimator: {words(found['estimator'])}."),
                    plain("dcc:norm", "ISO 9283:1998") if is_iso else None,
                ),
            ),
            _equipment(document),
            _conditions(document["subject"]["conditions"] or {}),
            element("dcc:results", *results_of(found, inputs)),
            *(conformity(found) if is_iso else ()),
        ),
    )


def _equipment(document: Json) -> Element:
    """Return what was measured with: the printed targets before a camera, or another instrument."""
    if document["source"] != "images":
        return element("dcc:measuringEquipments", named("dcc:measuringEquipment", "Another instrument"))
    return element(
        "dcc:measuringEquipments",
        *(_target(one) for one in document["inputs"]["targets"]),
        *([] if document["inputs"]["targets"] else [named("dcc:measuringEquipment", "Camera")]),
    )


def _target(target: Json) -> Element:
    certificate = target["certificate"] or {}
    numbers = [("other", target["id"], "target")]
    if certificate.get("number"):
        laboratory = certificate.get("laboratory") or "laboratory not stated"
        numbers.append(("calibrationLaboratory", certificate["number"], f"certificate of {laboratory}"))
    lengths = figure(
        "Pitch", "pitch_mm", target["pitch_mm"], u=target["pitch_standard_uncertainty_mm"] or None
    )
    if certificate.get("points_mm") is not None:
        name = "points_standard_uncertainty_mm"
        lengths += figure("Standard uncertainty of certified points along each axis", name, certificate[name])
    elif certificate.get("standard_uncertainty") is not None:
        for axis in "xy":
            name, key = f"Certified pitch along {axis}", f"pitch_{axis}_mm"
            lengths += figure(name, key, certificate[key], u=certificate["standard_uncertainty"][key] or None)
    return named(
        "dcc:measuringEquipment",
        f"Printed target {target['name']}",
        written(
            "dcc:description", f"{words(target['kind'])}, {target['columns']} × {target['rows']} grid points"
        ),
        element(
            "dcc:identifications",
            *(
                element(
                    "dcc:identification",
                    plain("dcc:issuer", by),
                    plain("dcc:value", value),
                    written("dcc:name", of),
                )
                for by, value, of in numbers
            ),
        ),
        element("dcc:measuringEquipmentQuantities", *(_as_equipment(one) for one in lengths)),
    )


def _as_equipment(quantity: Element) -> Element:
    quantity.tag = "dcc:measuringEquipmentQuantity"
    return quantity


def _conditions(conditions: Json) -> Element | None:
    stated = [
        named("dcc:influenceCondition", name, element("dcc:data", *figure(name, key, conditions[key])))
        for name, key in _CONDITIONS
        if conditions.get(key) is not None
    ]
    stated += [
        named("dcc:influenceCondition", name, element("dcc:data", written("dcc:text", conditions[key])))
        for name, key in (("Operator", "operator"), ("Notes", "notes"))
        if conditions.get(key)
    ]
    return element("dcc:influenceConditions", *stated) if stated else None
