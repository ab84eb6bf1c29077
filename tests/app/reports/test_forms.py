"""What the forms of a report carry beyond their text."""

from __future__ import annotations

import json
import re
import tarfile
from collections.abc import Mapping
from typing import Any

import pypdfium2
import pytest

from app.reports.forms import CompanyTemplate, render_forms
from app.reports.forms.figures import unit_of
from app.reports.forms.kinematics import ANGLES, _result, frame_blocks
from tests.reference.archives.make import FOLDER
from tests.support.sessions.archived_reports import archived_report, pdf_text


def test_the_pdf_carries_the_document_and_the_files_that_belong_to_it() -> None:
    with tarfile.open(FOLDER / "schema-0019.tar.gz") as archive:
        member = next(one for one in archive if one.name.endswith("/report.json"))
        document = json.load(archive.extractfile(member))  # type: ignore[arg-type]
    forms = render_forms(document, {}, CompanyTemplate(), {"robot.urdf": "<robot name='\u00e4'/>\n"})
    pdf = pypdfium2.PdfDocument(forms["pdf"])
    carried = {
        one.get_name(): bytes(one.get_data())
        for one in map(pdf.get_attachment, range(pdf.count_attachments()))
    }
    assert carried == {"report.json": forms["json"], "robot.urdf": "<robot name='\u00e4'/>\n".encode()}
    for page in pdf:
        assert document["report_id"] in page.get_textpage().get_text_range()


def test_a_report_says_that_its_cycles_are_means_of_several_images() -> None:
    document = archived_report("repeatability")
    assert "mean of its images" not in render_forms(document, {}, CompanyTemplate())["html"].decode()
    document["analyses"]["repeatability"]["bursts"] = {
        "stop_count": 74,
        "image_count": 185,
        "of_position": {"ratio_to_model": 1.0187, "p_value": 0.36, "added": False},
        "of_orientation": {"ratio_to_model": 2.416, "p_value": 1e-9, "added": True},
    }
    forms = render_forms(document, {}, CompanyTemplate())
    for text in (forms["html"].decode(), pdf_text(forms["pdf"])):
        assert "74 stops were seen in several images, 185 in all" in text
        assert "1.02 times in position and 2.42 times in orientation" in text
        assert "beyond it in orientation is in the floors" in text


def test_a_report_states_what_certifies_its_target_and_how_well() -> None:
    document = archived_report("repeatability")
    u = {"pitch_x_mm": 0.0005, "pitch_y_mm": 0.0007, "squareness_mrad": 0.02}
    lengths = {"pitch_x_mm": 20.0012, "pitch_y_mm": 19.9995, "squareness_mrad": 0.1}
    at = {"temperature_c": 20.0, "expansion_per_k": 8.5e-6}
    certificate: dict[str, Any] = {
        "number": "K 7",
        "laboratory": None,
        **lengths,
        **at,
        "standard_uncertainty": u,
    }
    document["inputs"]["targets"][0]["certificate"] = certificate
    document["subject"]["conditions"] = {"temperature_c": 23.0}
    text = render_forms(document, {}, CompanyTemplate())["html"].decode()
    assert "x 20.0012 mm, u = 0.0005 mm; y 19.9995 mm, u = 0.0007 mm" in text
    assert "20 °C, 8.5e-06 a kelvin; taken to 23 °C" in text
    certificate |= {"points_mm": [[0.0, 0.0, 0.0]] * 140, "points_standard_uncertainty_mm": 0.001}
    text = render_forms(document, {}, CompanyTemplate())["html"].decode()
    assert "140, u = 0.001 mm along each axis" in text


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("poses[P1].repeatability.rp_l_mm", "mm"),
        ("poses[P1].mean.position_mm[2]", "mm"),
        ("drift.poses[P1].rate_mm_per_h[1]", "mm/h"),
        ("drift.poses[P1].rate_standard_uncertainty_mm_per_h[1]", "mm/h"),
        ("drift.poses[P1].duration_h", "h"),
        ("error_model.compliance[2].rad_per_m", "rad/m"),
        ("poses[P1].accuracy.ap_roll_deg", "degree"),
        ("poses[P1].accuracy.degrees_of_freedom", ""),
    ],
)
def test_a_figure_s_unit_is_that_of_its_name(name: str, unit: str) -> None:
    assert unit_of(name) == unit


def test_a_report_has_the_rotation_vectors_that_its_warnings_send_to() -> None:
    document = archived_report("repeatability")
    captions = ("Scatter of orientation by rotation vectors: 3 S", "AP of orientation by rotation vectors")
    plain = render_forms(document, {}, CompanyTemplate())["html"].decode()
    assert not any(caption in plain for caption in captions)
    found = document["analyses"]["repeatability"]
    pose = found["poses"][0]
    pose["orientation_scatter"] = {
        "rotation_vector_deg": [0.01534, 0.0147, 0.0159],
        "roll_pitch_yaw_deg": [0.9, 0.0147, 0.9],
    }
    pose["accuracy"] = {
        **_accuracy(0.4),
        "ap_rotation_vector_deg": [-0.00121, 0.000353, 0.0105],
        **dict.fromkeys(("ap_roll_deg", "ap_pitch_deg", "ap_yaw_deg")),
    }
    found["warnings"].append({"code": "near_gimbal_lock", "detail": "Pose P1: near.", "advice": None})
    forms = render_forms(document, {}, CompanyTemplate())
    for text in (forms["html"].decode(), pdf_text(forms["pdf"])):
        assert all(caption in text for caption in captions)
        assert all(shown in text for shown in ("0.015", "\u22120.00121", "0.000353", "0.0105"))


def test_accuracy_of_unknown_uncertainty_is_given_without_an_interval() -> None:
    document = archived_report("repeatability")
    found = document["analyses"]["repeatability"]
    found["poses"][0]["accuracy"] = _accuracy(0.1234, held_out=0.15)
    for way in found["distances"]:
        way |= {"standard_uncertainty_mm": None, "ad_interval_mm": None}
    forms = render_forms(document, {}, CompanyTemplate())
    page = forms["html"].decode()
    assert "0.123 mm at pose P1, interval not known" in page
    assert "None" not in page.replace("None.", "").replace("None:", "")


def test_the_largest_ap_is_that_of_all_poses_with_one_visit_or_more() -> None:
    document = archived_report("repeatability")
    found = document["analyses"]["repeatability"]
    seen, once = found["poses"][:2]
    for pose, value in ((seen, 0.4), (once, 0.5)):
        pose["accuracy"] = _accuracy(value)
    for part in ("repeatability", "interval", "corrected", "corrected_interval", "noise_floor"):
        once[part] = dict.fromkeys(once[part])
    once["verdict"] = "too_few_cycles"
    page = render_forms(document, {}, CompanyTemplate())["html"].decode()
    assert f"0.500 mm at pose {once['pose_id']}, interval not known" in page
    for pose in found["poses"]:
        pose["repeatability"] = dict.fromkeys(pose["repeatability"])
    page = render_forms(document, {}, CompanyTemplate())["html"].decode()
    assert "No repeatability is known" in page
    assert f"0.500 mm at pose {once['pose_id']}, interval not known" in page


def test_a_corrected_figure_is_given_where_it_is_determined() -> None:
    document = archived_report("repeatability")
    first = document["analyses"]["repeatability"]["poses"][0]
    first["corrected"]["rp_l_mm"], first["corrected_interval"]["rp_l_mm"] = 0.0678, [0.05, 0.08]
    forms = render_forms(document, {}, CompanyTemplate())
    for form in ("html", "xml"):
        assert "0.0678" in forms[form].decode()
    first["corrected_interval"]["rp_l_mm"] = None
    forms = render_forms(document, {}, CompanyTemplate())
    for form in ("html", "xml"):
        assert "0.0678" not in forms[form].decode()


def test_a_decision_that_is_open_names_its_pose_and_no_interval_that_decides() -> None:
    document = archived_report("repeatability")
    found = document["analyses"]["repeatability"]
    one = {
        "rule": "guard bands",
        "decision": "inconclusive",
        "cycles_needed": 26,
        "reason": "it spans the limit",
    }
    at_one = {"pose_id": "P3", "interval_mm": [0.0964, 0.2716], "datasheet_repeatability_mm": 0.1}
    nowhere = {"pose_id": None, "interval_mm": None, "datasheet_accuracy_mm": 0.6}
    found["acceptance"], found["accuracy_acceptance"] = {**one, **at_one}, {**one, **nowhere}
    page = render_forms(document, {}, CompanyTemplate())["html"].decode()
    assert "open at" in page
    assert "pose P3, 95 % interval 0.096 … 0.272 mm" in page
    assert "that decides" not in page
    assert (
        page.count("by its own cycles alone") == page.count("the frames that the other poses tie, too") == 1
    )
    found["acceptance"]["decision"] = "pass"
    assert "decided at" in render_forms(document, {}, CompanyTemplate())["html"].decode()


def test_terms_that_the_lens_model_holds_at_zero_are_named_and_not_listed() -> None:
    document = archived_report("camera")
    (group,) = document["analyses"]["intrinsics"]["groups"]
    group["distortion"]["k3"] = group["standard_uncertainty"]["k3"] = 0.0
    forms = render_forms(document, {}, CompanyTemplate())
    page = forms["html"].decode()
    assert "<dt>not in the model, zero</dt><dd>k3</dd>" in page
    assert "<td>k3</td>" not in page
    assert "<td>k1</td>" in page
    assert 'refType="gridpose_k3"' not in forms["xml"].decode()
    assert "groups[1].distortion.k3,0.0," in forms["csv"].decode(), "programs have every term"
    # A term that is held at another value is part of the camera.
    group["standard_uncertainty"]["k1"] = 0.0
    page = render_forms(document, {}, CompanyTemplate())["html"].decode()
    assert re.search(r"<td>k1</td><td>1</td><td[^>]*>−?0\.\d+</td><td[^>]*>held</td>", page)


@pytest.mark.parametrize(
    ("code", "heading"),
    [("too_few_cycles", "No repeatability is stated"), ("cycles_not_stated", "Cycles are not stated")],
)
def test_a_report_whose_figures_are_no_repeatability_begins_with_that(code: str, heading: str) -> None:
    document = archived_report("repeatability")
    for kind in ("repeatability", "session"):
        whole = {**document, "kind": kind, "refusals": {}}
        for form in ("html", "pdf"):
            assert heading not in _shown(render_forms(whole, {}, CompanyTemplate()), form)
    said = {
        "code": code,
        "detail": "What is stated is no repeatability.",
        "advice": "Visit every pose again.",
    }
    document["analyses"]["repeatability"]["warnings"].append(said)
    for kind in ("repeatability", "session"):
        forms = render_forms({**document, "kind": kind, "refusals": {}}, {}, CompanyTemplate())
        for form in ("html", "pdf"):
            shown = _shown(forms, form)
            assert shown.index(heading) < shown.index("no repeatability") < shown.index("Conditions")
            assert shown.count("Visit every pose again.") == 1
    certificate = render_forms(document, {}, CompanyTemplate())["xml"].decode()
    assert certificate.index(heading) < certificate.index("gridpose_cycles")


def test_where_nothing_was_repeated_there_is_no_drawing_of_scatter() -> None:
    document = archived_report("repeatability")
    drawings = {"scatter": ['<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 10 10"/>']}
    caption = "Cycles of each pose about their mean"
    assert caption in render_forms(document, drawings, CompanyTemplate())["html"].decode()
    for pose in document["analyses"]["repeatability"]["poses"]:
        pose["cycles"] = 1
        for part in ("repeatability", "interval", "corrected", "corrected_interval", "noise_floor"):
            pose[part] = dict.fromkeys(pose[part])
    page = render_forms(document, drawings, CompanyTemplate())["html"].decode()
    assert caption not in page
    assert "RP along the axes" not in page, "a table of dashes"


def _shown(forms: Mapping[str, bytes], form: str) -> str:
    return pdf_text(forms["pdf"]) if form == "pdf" else forms[form].decode()


def _accuracy(value: float, held_out: float | None = None) -> dict[str, Any]:
    """The AP of a pose whose uncertainty is not known."""
    names = [f"ap_{axis}" for axis in ("p_mm", "x_mm", "y_mm", "z_mm", "roll_deg", "pitch_deg", "yaw_deg")]
    return dict.fromkeys(names, value) | {
        "ap_rotation_vector_deg": None,
        "interval": dict.fromkeys(names),
        "held_out": dict.fromkeys(names, held_out),
        "degrees_of_freedom": 9.0,
        "tie": "best_fit",
    }


def test_held_out_measurements_are_counted_as_what_they_are() -> None:
    errors = {"position_rms_mm": 0.1, "rotation_rms_deg": None}
    found: dict[str, Any] = {
        "method": "global",
        "model": "dh",
        "convention": "classic_dh",
        "residual": errors,
    }
    found["validation"] = {**errors, "held_out_poses": 240, "nominal": None}
    for source, counted in (("images", "240 images"), ("measured_poses", "240 readings")):
        _, block = _result({**found, "source": source})
        assert dict(block["rows"])["held out"].endswith(counted)


def test_frames_of_the_kinematics_stand_with_their_uncertainties() -> None:
    known = {
        "x_mm": 0.0123,
        "y_mm": 0.02,
        "z_mm": None,
        "roll_deg": 0.004,
        "pitch_deg": 0.004,
        "yaw_deg": 0.005,
    }
    rows = [[1.0, 0.0, 0.0, 30.12345], [0.0, 1.0, 0.0, -7.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
    camera: dict[str, Any] = {
        "T_flange_camera": rows,
        "standard_uncertainty": known,
        **dict.fromkeys(ANGLES, 12.34567),
    }
    _, grid, angles = frame_blocks({"flange_camera": camera, "base_targets": None, "source": "images"})
    assert "uncertainty" in grid["caption"]
    assert grid["columns"][-2:] == ["position", "u"]
    assert [row[-2:] for row in grid["rows"]] == [["30.123", "0.012"], ["−7.000", "0.020"], ["0.000", "–"]]
    assert "12.3457° (u 0.0040°)" in angles["rows"][0][1]
    # A report of an earlier version states none.
    del camera["standard_uncertainty"]
    _, grid = frame_blocks({"flange_camera": camera, "base_targets": None, "source": "images"})
    assert [row[-1] for row in grid["rows"]] == ["–"] * 3
