"""Reports as Digital Calibration Certificates: valid by the published schema, with the report's own figures."""

from __future__ import annotations

import copy
import json
import os
import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from lxml import etree

from app.reports.forms.certificate import certificate_xml

DCC, SI = "{https://ptb.de/dcc}", "{https://ptb.de/si}"
ARCHIVE = Path(__file__).parents[2] / "reference" / "archives" / "schema-0019.tar.gz"
SHA256 = "0" * 64
HOSTILE = " <b>&\x00\u202e" + "x" * 200
Validate = Callable[[dict[str, Any]], etree._Element]


@pytest.fixture(scope="module")
def schema() -> etree.XMLSchema:
    """The published schema, which is not part of the project; nothing is fetched."""
    default = Path(__file__).parents[4] / "shared" / "reference" / "dcc"
    folder = Path(os.environ.get("GRIDPOSE_TEST_DCC", default))
    if not folder.is_dir():
        pytest.skip("the schemas of the certificate are not here: set GRIDPOSE_TEST_DCC to their folder")

    class LocalSchemas(etree.Resolver):
        def resolve(self, url: str, _public: str, context: Any) -> Any:
            name = url.rpartition("/")[2]
            return self.resolve_filename(
                str(folder / ("SI_Format_2_1_0.xsd" if name == "SI_Format.xsd" else name)), context
            )

    parser = etree.XMLParser(no_network=True)
    parser.resolvers.add(LocalSchemas())
    return etree.XMLSchema(etree.parse(str(folder / "dcc_3_2_0.xsd"), parser))


@pytest.fixture(scope="module")
def documents() -> dict[str, dict[str, Any]]:
    """Reports that an earlier version made of images, by kind, and one of a robot's kinematics."""
    found: dict[str, dict[str, Any]] = {}
    with tarfile.open(ARCHIVE) as archive:
        for member in archive:
            if member.name.endswith("/report.json"):
                document = json.load(archive.extractfile(member))  # type: ignore[arg-type]
                found[document["kind"]] = document
    found["kinematics"] = {
        **found["repeatability"],
        "kind": "kinematics",
        "analyses": {"dh": _kinematics()},
    }
    return found


@pytest.fixture
def validate(schema: etree.XMLSchema) -> Validate:
    def valid(document: dict[str, Any]) -> etree._Element:
        content = certificate_xml(document, SHA256)
        assert content is not None
        root = etree.fromstring(content)
        schema.assertValid(root)
        return root

    return valid


@pytest.mark.parametrize("kind", ["repeatability", "camera", "kinematics"])
def test_a_report_of_each_kind_is_valid(
    validate: Validate, documents: dict[str, dict[str, Any]], kind: str
) -> None:
    root = validate(documents[kind])
    assert root.find(f".//{DCC}uniqueIdentifier").text == documents[kind]["report_id"]  # type: ignore[union-attr]
    assert "not stated: country" in texts(root)


def test_figures_are_those_of_the_report(validate: Validate, documents: dict[str, dict[str, Any]]) -> None:
    document = documents["repeatability"]
    found = document["analyses"]["repeatability"]
    root = validate(document)
    for pose in found["poses"]:
        total = next(
            one
            for one in found["budget_totals"]
            if (one["figure"], one["pose_id"]) == ("repeatability.rp_l_mm", pose["pose_id"])
        )
        real = quantity(root, f"Pose {pose['pose_id']}", "gridpose_repeatability.rp_l_mm")
        assert number(real, "value") == pose["repeatability"]["rp_l_mm"]
        assert real.findtext(f"{SI}unit") == r"\milli\metre"
        interval = real.find(f"{SI}coverageInterval")
        assert interval is not None
        assert [number(interval, f"interval{end}") for end in ("Min", "Max")] == pose["interval"]["rp_l_mm"]
        assert number(interval, "standardUnc") == total["standard_uncertainty_mm"]
        assert number(interval, "coverageProbability") == found["confidence_level"]
    camera = validate(documents["camera"])
    (group,) = documents["camera"]["analyses"]["intrinsics"]["groups"]
    real = quantity(camera, f"Camera of focus group {group['focus_group']}", "gridpose_fx_px")
    assert (number(real, "value"), real.findtext(f"{SI}unit")) == (group["intrinsics"]["fx_px"], r"\one")
    expanded = real.find(f"{SI}expandedUnc")
    assert expanded is not None
    u = number(expanded, "uncertainty") / number(expanded, "coverageFactor")
    assert u == pytest.approx(group["standard_uncertainty"]["fx_px"], rel=1e-12)


def test_the_mean_distance_is_covered_as_its_few_cycles_ask(
    validate: Validate, documents: dict[str, dict[str, Any]]
) -> None:
    """With k of the normal distribution five cycles held the distance in 88 % where 95 % are stated."""
    document = copy.deepcopy(documents["repeatability"])
    ends = {"from_pose_id": "P1", "to_pose_id": "P2"}
    unknown = dict.fromkeys(("ad_mm", "ad_interval_mm", "rd_mm", "interval_mm", "noise_floor_mm"))
    known = {"cycles": 5, "mean_mm": 200.0, "standard_uncertainty_mm": 0.01}
    document["analyses"]["repeatability"]["distances"] = [{**ends, **unknown, **known}]
    expanded = quantity(validate(document), "Distance from pose P1 to pose P2", "gridpose_mean_mm")
    assert float(expanded.findtext(f".//{SI}coverageFactor") or "") == pytest.approx(2.776, abs=1e-3)


def test_repeatability_without_the_outliers_is_a_quantity_of_its_own(
    validate: Validate, documents: dict[str, dict[str, Any]]
) -> None:
    document = copy.deepcopy(documents["repeatability"])
    first = document["analyses"]["repeatability"]["poses"][0]
    first["without_outliers"] = {**first["repeatability"], "rp_l_mm": 0.0512}
    outlier = {
        "measurement_id": "mea_9",
        "cycle": 3,
        "distance_mm": 9.0,
        "detail": "It is far from the others.",
    }
    first["outliers"] = [{**outlier, "code": "position_outlier"}]
    root = validate(document)
    name = f"Pose {first['pose_id']}"
    for part, value in (("repeatability", first["repeatability"]["rp_l_mm"]), ("without_outliers", 0.0512)):
        assert number(quantity(root, name, f"gridpose_{part}.rp_l_mm"), "value") == value
    assert "cycles: without cycle 3; n: 4" in texts(root)
    assert "Uncertainty budget (GUM)" in texts(root)
    assert "Quote the interval." in texts(root)


def test_parameters_that_are_not_determined_have_no_quantity(
    validate: Validate, documents: dict[str, dict[str, Any]]
) -> None:
    root = validate(documents["kinematics"])
    assert number(quantity(root, "Joint 1", "gridpose_a_mm"), "value") == 180.1
    assert not [one for one in root.iter(f"{DCC}quantity") if one.get("refType") == "gridpose_d_mm"]
    assert "d1 cannot be separated" in texts(root)


def test_accuracy_conditions_and_decisions_are_stated(
    validate: Validate, documents: dict[str, dict[str, Any]]
) -> None:
    document = copy.deepcopy(documents["repeatability"])
    found = document["analyses"]["repeatability"]
    axes = ("ap_x_mm", "ap_y_mm", "ap_z_mm", "ap_roll_deg", "ap_pitch_deg", "ap_yaw_deg")
    figures = {"ap_p_mm": 0.2, **dict.fromkeys(axes, 1e-7), "ap_yaw_deg": None}
    intervals = {name: None if value is None else [0.0, 1.0] for name, value in figures.items()}
    found["poses"][0]["accuracy"] = {**figures, "interval": intervals, "held_out": figures}
    limits = {"rule": "ISO 14253-1 guard band", "reason": "all lies beyond the limit", "decision": "fail"}
    found["acceptance"] = {**limits, "datasheet_repeatability_mm": 0.02}
    found["accuracy_acceptance"] = {**limits, "decision": "inconclusive", "datasheet_accuracy_mm": 0.5}
    conditions = {"load_kg": 5.0, "speed_percent": 100.0, "temperature_c": 21.5, "warm_up_min": 60.0}
    document["subject"]["conditions"] = {**conditions, "operator": "R. Meier", "notes": None}
    certified = {"pitch_x_mm": 20.004, "pitch_y_mm": 20.002}
    document["inputs"]["targets"][0] |= {
        "pitch_standard_uncertainty_mm": 0.001,
        "certificate": {
            **{"number": "K 12", "laboratory": "Example", **certified},
            "standard_uncertainty": dict.fromkeys([*certified, "squareness_mrad"], 0.0005),
        },
    }
    root = validate(document)
    lengths = {one.get("refType"): one for one in root.iter(f"{DCC}measuringEquipmentQuantity")}
    for key, value in certified.items():
        stated = [lengths[f"gridpose_{key}"].findtext(f".//{SI}{name}") for name in ("value", "uncertainty")]
        assert [float(one or "") for one in stated] == pytest.approx([value, 1.96 * 0.0005], rel=1e-4)
    name = f"Pose {found['poses'][0]['pose_id']}"
    assert number(quantity(root, name, "gridpose_accuracy.ap_p_mm"), "value") == 0.2
    assert [one.text for one in root.iter(f"{DCC}conformity")] == ["fail"]
    assert "inconclusive: all lies beyond the limit" in texts(root)
    units = {one.text for one in root.iter(f"{SI}unit")}
    assert {r"\kilogram", r"\percent", r"\degreecelsius", r"\minute"} <= units
    assert "K 12" in {one.text for one in root.iter(f"{DCC}value")}


def test_what_a_company_states_is_in_its_place(
    validate: Validate, documents: dict[str, dict[str, Any]]
) -> None:
    document = copy.deepcopy(documents["repeatability"])
    document["template"] = {
        "organisation": "Example Metrology",
        "address": ["Street 1", "12345 Town"],
        "footer": None,
        "fields": {"Order": "4711"},
        "certificate": {
            "country": "DE",
            "laboratory_code": "D-K-1",
            "performed_at": "customer",
            "customer": "Works 2",
            "customer_address": ["Road 7"],
        },
    }
    document["signatories"] = [{"name": "R. Meier", "role": None}]
    document["subject"] |= {
        "first_captured_at": "2026-01-31T23:00:00Z",
        "last_captured_at": "2026-02-01T01:00:00Z",
    }
    root = validate(document)
    for name, text in (
        ("countryCodeISO3166_1", "DE"),
        ("performanceLocation", "customer"),
        ("calibrationLaboratoryCode", "D-K-1"),
        ("beginPerformanceDate", "2026-01-31"),
        ("endPerformanceDate", "2026-02-01"),
    ):
        assert root.find(f".//{DCC}{name}").text == text  # type: ignore[union-attr]
    assert {"Works 2", "Road 7", "Street 1", "R. Meier"} <= set(texts(root).splitlines())
    assert "not stated: country" not in texts(root)


def test_texts_of_users_are_text(validate: Validate, documents: dict[str, dict[str, Any]]) -> None:
    document = copy.deepcopy(documents["repeatability"])
    document["inputs"]["robot"] |= {
        "name": HOSTILE,
        "manufacturer": "\u00a0",
        "model": " ",
        "serial_number": HOSTILE,
    }
    document["signatories"] = [{"name": "\t", "role": HOSTILE}]
    document["template"]["fields"] = {HOSTILE: HOSTILE}
    document["analyses"]["repeatability"]["poses"][0]["pose_id"] = HOSTILE
    root = validate(document)
    assert "<b>&\ufffd\u202e" + "x" * 200 in texts(root).splitlines()
    assert not list(root.iter("b"))


def test_a_report_on_a_whole_session_is_no_certificate(documents: dict[str, dict[str, Any]]) -> None:
    assert certificate_xml({**documents["repeatability"], "kind": "session"}, SHA256) is None


def texts(root: etree._Element) -> str:
    return "\n".join(one.text or "" for one in root.iter(f"{DCC}content"))


def quantity(root: etree._Element, result: str, reference: str) -> etree._Element:
    (real,) = [
        one.find(f"{SI}real")
        for found in root.iter(f"{DCC}result")
        if found.findtext(f"{DCC}name/{DCC}content") == result
        for one in found.iter(f"{DCC}quantity")
        if one.get("refType") == reference
    ]
    assert real is not None
    return real


def number(of: etree._Element, name: str) -> float:
    return float(of.findtext(f"{SI}{name}") or "")


def _kinematics() -> dict[str, Any]:
    names = ("a_mm", "alpha_deg", "d_mm", "theta_offset_deg", "beta_deg")
    errors = {"position_rms_mm": 0.1, "rotation_rms_deg": 0.01}
    joint = {
        "joint": 1,
        **dict(zip(names, (180.1, -90.0, 400.0, 0.0, None), strict=True)),
        "standard_uncertainty": {**dict.fromkeys(names), "a_mm": 0.03, "alpha_deg": 0.002},
        "nominal": {"a_mm": 180.0, "alpha_deg": -90.0, "d_mm": 400.0, "theta_offset_deg": 0.0},
        "identifiable": {name: name in ("a_mm", "alpha_deg") for name in names},
        "arc_deg": 80.0,
        "poses": 74,
    }
    return {
        "estimator": "pooled",
        "method": "global",
        "model": "auto",
        "convention": "classic_dh",
        "source": "images",
        "joints": [joint],
        "residual": errors,
        "validation": {
            **errors,
            "held_out_poses": 74,
            "random": errors,
            "blocked": None,
            "nominal": {**errors, "rotation_rms_deg": None},
        },
        "error_model": None,
        "method_agreement": None,
        "null_space": [{"sentence": "theta1 offset and d1 cannot be separated from the base transform."}],
        "flange_camera": None,
        "base_targets": None,
        "excluded": [],
        "warnings": [],
    }
