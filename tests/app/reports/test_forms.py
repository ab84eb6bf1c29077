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
from app.reports.forms.kinematics import ANGLES, _result, frame_blocks
from tests.reference.archives.make import FOLDER


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


def test_repeatability_without_the_outliers_stands_second_to_the_headline_in_each_form() -> None:
    document = _with_an_outlier(_fixture("repeatability"))
    forms = render_forms(document, {}, CompanyTemplate())
    page, print_out = forms["html"].decode(), _pdf_text(forms["pdf"])
    for text in (page, print_out):
        assert text.index("largest RP_l") < text.index("without its outliers") < text.index("Outliers; they")
        assert "0.0512 mm without cycle 3, for comparison alone: it counts above" in text
        assert text.count("RP without the outliers, for comparison alone") >= 1
    assert '<td>without cycle 3</td><td class="right">4</td><td class="right">0.0512</td>' in page
    assert "repeatability,poses[P1].without_outliers.rp_l_mm,0.0512,mm" in forms["csv"].decode()
    assert "repeatability,poses[P1].outliers[mea_9].cycle,3," in forms["csv"].decode()
    certificate = forms["xml"].decode()
    assert 'refType="gridpose_without_outliers.rp_l_mm"' in certificate
    assert "cycles: without cycle 3; n: 4; RP_l, mm: 0.0512" in certificate


def test_a_figure_has_the_same_digits_wherever_a_report_states_it() -> None:
    document = _with_an_outlier(_fixture("repeatability"))
    found = document["analyses"]["repeatability"]
    pose = found["poses"][0]
    pose["repeatability"]["rp_l_mm"], pose["interval"]["rp_l_mm"] = 0.7961, [0.6124, 0.9714]
    for part in ("corrected", "corrected_interval", "without_outliers"):
        pose[part] = dict.fromkeys(pose[part])
    (total,) = [
        one
        for one in found["budget_totals"]
        if (one["figure"], one["pose_id"]) == ("repeatability.rp_l_mm", pose["pose_id"])
    ]
    total |= {"value_mm": 0.7961, "standard_uncertainty_mm": 0.066, "interval_mm": [0.6124, 0.9714]}
    found["acceptance"] = {
        "decision": "undecided",
        "datasheet_repeatability_mm": 0.9,
        "rule": "The interval holds the limit.",
        "reason": "More cycles decide.",
        "interval_mm": [0.6124, 0.9714],
        "pose_id": pose["pose_id"],
    }
    pages = [
        render_forms({**document, "kind": kind, "refusals": {}}, {}, CompanyTemplate())["html"].decode()
        for kind in ("repeatability", "session")
    ]
    for page in pages:
        stated = set(re.findall(r"0\.(?:79|80)\d*", page))
        assert stated == {"0.796"}, stated
        assert "0.612 … 0.971" in page
    assert "pose P1, 95 % interval 0.612 … 0.971 mm" in pages[0]


def test_outliers_are_named_once_each_and_by_their_measurements_without_cycle_numbers() -> None:
    document = _with_an_outlier(_fixture("repeatability"))
    first = document["analyses"]["repeatability"]["poses"][0]
    (outlier,) = first["outliers"]
    image = document["inputs"]["images"][0]
    image |= {"filename": "a_1.png", "cycle": None}
    first["outliers"] = [
        outlier,
        {**outlier, "code": "orientation_outlier"},
        {**outlier, "measurement_id": "mea_8", "cycle": None},
        {**outlier, "measurement_id": image["measurement_id"], "cycle": None},
    ]
    page = render_forms(document, {}, CompanyTemplate())["html"].decode()
    assert (
        f'<td>without cycles 3, an image, a_1.png ({image["pose_id"]})</td><td class="right">2</td>' in page
    )
    assert "they count above" in page


def test_the_report_on_a_session_says_what_verdicts_mean_and_why_cycles_are_excluded() -> None:
    document = _with_an_outlier(_fixture("repeatability"))
    image = document["inputs"]["images"][0]
    document["analyses"]["repeatability"]["excluded"] = [
        {
            "measurement_id": image["measurement_id"],
            "filename": None,
            "code": "image_degraded",
            "detail": "Its residuals have noise that the other images do not have.",
        }
    ]
    session = {**document, "kind": "session", "refusals": {}}
    page = render_forms(session, {}, CompanyTemplate())["html"].decode()
    for text in (
        "too few cycles: A verdict takes ten cycles or more",
        "without cycle 3",
        "Excluded from repeatability",
        "image degraded",
    ):
        assert text in page


def test_rp_with_degraded_images_stands_second_and_what_does_not_count_is_named() -> None:
    document = _fixture("repeatability")
    found = document["analyses"]["repeatability"]
    image, pose = document["inputs"]["images"][0], found["poses"][0]
    pose["including_degraded"] = dict.fromkeys(pose["repeatability"], 0.02) | {"rp_l_mm": 0.0777}
    found["excluded"] = [
        {
            "measurement_id": image["measurement_id"],
            "filename": None,
            "code": "image_degraded",
            "detail": "Its residuals have noise that the other images do not have.",
        }
    ]
    forms = render_forms(document, {}, CompanyTemplate())
    page = forms["html"].decode()
    caption = "RP with the cycles of degraded images, which do not count; for comparison alone"
    assert caption in page
    assert '<td>with degraded images</td><td class="right">0.0777</td>' in page
    assert caption in _pdf_text(forms["pdf"])
    assert 'refType="gridpose_including_degraded.rp_l_mm"' in forms["xml"].decode()
    table = forms["csv"].decode().splitlines()
    name = f"repeatability,excluded[{image['measurement_id']}]"
    assert f"{name}.pose_id,{image['pose_id']}," in table
    assert f"{name}.cycle,{image['cycle']}," in table
    whole = render_forms({**document, "kind": "session", "refusals": {}}, {}, CompanyTemplate())["html"]
    assert caption in whole.decode()


def test_accuracy_of_unknown_uncertainty_is_given_without_an_interval() -> None:
    document = _fixture("repeatability")
    found = document["analyses"]["repeatability"]
    found["poses"][0]["accuracy"] = _accuracy(0.1234, held_out=0.15)
    for way in found["distances"]:
        way |= {"standard_uncertainty_mm": None, "ad_interval_mm": None}
    forms = render_forms(document, {}, CompanyTemplate())
    page = forms["html"].decode()
    assert "0.123 mm at pose P1, interval not known" in page
    assert "None" not in page.replace("None.", "").replace("None:", "")


def test_the_largest_ap_is_that_of_all_poses_with_one_visit_or_more() -> None:
    document = _fixture("repeatability")
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
    document = _fixture("repeatability")
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
    document = _fixture("repeatability")
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


def test_a_report_without_outliers_says_nothing_of_figures_without_them() -> None:
    document = _fixture("repeatability")
    for pose in document["analyses"]["repeatability"]["poses"]:
        pose.pop("without_outliers")
    forms = render_forms(document, {}, CompanyTemplate())
    for name in ("html", "xml"):
        assert b"without the outliers" not in forms[name]
        assert "u, mm" in forms[name].decode()  # the budget


def test_terms_that_the_lens_model_holds_at_zero_are_named_and_not_listed() -> None:
    document = _fixture("camera")
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
    document = _fixture("repeatability")
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
    document = _fixture("repeatability")
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
    return _pdf_text(forms["pdf"]) if form == "pdf" else forms[form].decode()


def _fixture(kind: str) -> dict[str, Any]:
    with tarfile.open(FOLDER / "schema-0019.tar.gz") as archive:
        for member in archive:
            if member.name.endswith("/report.json"):
                document: dict[str, Any] = json.load(archive.extractfile(member))  # type: ignore[arg-type]
                if document["kind"] == kind:
                    return document
    raise LookupError(kind)


def _with_an_outlier(document: dict[str, Any]) -> dict[str, Any]:
    """The report as of a session whose first pose has an outlier in its third cycle."""
    first = document["analyses"]["repeatability"]["poses"][0]
    first["repeatability"]["rp_l_mm"], first["interval"]["rp_l_mm"] = 9.0, [4.0, 20.0]
    first["without_outliers"] = dict.fromkeys(first["repeatability"], 0.01) | {"rp_l_mm": 0.0512}
    first["outliers"] = [
        {
            "measurement_id": "mea_9",
            "cycle": 3,
            "code": "position_outlier",
            "distance_mm": 9.0,
            "detail": "It is farther from the mean of the others than they explain.",
        }
    ]
    return document


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


def _pdf_text(content: bytes) -> str:
    text = " ".join(page.get_textpage().get_text_range() for page in pypdfium2.PdfDocument(content))
    return " ".join(text.split())


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
