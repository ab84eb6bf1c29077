"""Outliers and images that do not count, in each form of a report: named once, the figures without them second."""

from __future__ import annotations

import re
from typing import Any

from app.reports.forms import CompanyTemplate, render_forms
from tests.support.sessions.archived_reports import archived_report, pdf_text


def test_repeatability_without_the_outliers_stands_second_to_the_headline_in_each_form() -> None:
    document = _with_an_outlier(archived_report("repeatability"))
    forms = render_forms(document, {}, CompanyTemplate())
    page, print_out = forms["html"].decode(), pdf_text(forms["pdf"])
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
    document = _with_an_outlier(archived_report("repeatability"))
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
    document = _with_an_outlier(archived_report("repeatability"))
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
    document = _with_an_outlier(archived_report("repeatability"))
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
    document = archived_report("repeatability")
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
    assert caption in pdf_text(forms["pdf"])
    assert 'refType="gridpose_including_degraded.rp_l_mm"' in forms["xml"].decode()
    table = forms["csv"].decode().splitlines()
    name = f"repeatability,excluded[{image['measurement_id']}]"
    assert f"{name}.pose_id,{image['pose_id']}," in table
    assert f"{name}.cycle,{image['cycle']}," in table
    whole = render_forms({**document, "kind": "session", "refusals": {}}, {}, CompanyTemplate())["html"]
    assert caption in whole.decode()


def test_a_report_without_outliers_says_nothing_of_figures_without_them() -> None:
    document = archived_report("repeatability")
    for pose in document["analyses"]["repeatability"]["poses"]:
        pose.pop("without_outliers")
    forms = render_forms(document, {}, CompanyTemplate())
    for name in ("html", "xml"):
        assert b"without the outliers" not in forms[name]
        assert "u, mm" in forms[name].decode()  # the budget


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
