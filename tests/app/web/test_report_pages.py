"""Pages of reports keep whoever chose wrongly where the choice is made, and say what there is not."""

from __future__ import annotations

import re
from typing import Any

from app.analyses.history import summarise_reports
from app.services.reports import NewReport, order_report
from app.web.pages import environment
from app.web.routes.histories import supported
from tests.support.service.signed_in import signed_in
from tests.support.sessions.filed_reports import content, joint_content, store_filed


def test_a_comparison_of_none_leads_back_to_the_list_with_a_sentence(api: Any) -> None:
    session_id = api.make_session()
    with api.installation.database.write() as records:
        new = NewReport(kind="camera", title=None, signatories=[], paper="a4")
        report = order_report(records, session_id, new).report
        report.status = "succeeded"
        report_id = report.id
    head = signed_in(api)
    for query, of, said in (
        ("", "/ui/reports", "none is ticked"),
        (f"?report={report_id}", "/ui/reports", "one is ticked"),
        (f"?of={session_id}", f"/ui/sessions/{session_id}/reports", "none is ticked"),
        ("?report=a&report=b&report=c", "/ui/reports", "3 are ticked"),
    ):
        led = api.client.get(f"/ui/reports/comparison{query}", headers=head, follow_redirects=False)
        assert led.status_code == 303
        assert led.headers["location"].split("?")[0] == of
        found = api.client.get(led.headers["location"], headers=head)
        assert found.status_code == 200
        assert f"Two reports are compared, and {said}: tick two." in found.text
    listed = api.client.get(f"/ui/sessions/{session_id}/reports", headers=head).text
    assert f'name="of" value="{session_id}"' in listed
    assert "tick two" not in listed


def test_what_there_is_not_is_said_with_the_list_where_it_would_be(api: Any) -> None:
    missing = "0" * 26
    for address, noun, listed in (
        (f"sessions/ses_{missing}", "session", "/ui/"),
        (f"sessions/ses_{missing}/repeatability", "session", "/ui/"),
        (f"reports/rep_{missing}", "report", "/ui/reports"),
        (f"robots/rob_{missing}", "robot", "/ui/robots"),
        (f"targets/tgt_{missing}", "target", "/ui/targets"),
    ):
        found = api.client.get(f"/ui/{address}", headers=signed_in(api))
        assert found.status_code == 404
        assert f"There is no such {noun}." in found.text
        assert "It was deleted, or the address is not right." in found.text
        assert "load the page again" not in found.text
        assert re.search(rf'<a class="button" href="{listed}">All \w+</a>', found.text)


def verification(**found: Any) -> str:
    """What the page says of a verification that differs in one figure."""
    one = {"path": "a.fx_px", "then": "650", "now": "650.001", "relative_difference": 1.5e-6, **found}
    answer = {
        "agrees": False,
        "recomputed_from": "report",
        "figures": 10,
        "figures_equal": 9,
        "digits": 5,
        "largest_difference_in_uncertainties": one["in_uncertainties"],
        "differences": [one],
        "changed_inputs": [],
        "unavailable_inputs": [],
        "current_values": [],
        "damaged_forms": [],
        "is_current": True,
        "originals": {"measured": 0, "differing": []},
        "core_version_then": "0.1.0+a",
        "core_version_now": one.pop("build", "0.1.0+b"),
        **one.pop("changed", {}),
    }
    names = one.pop("image_names", {})
    page = environment().get_template("reports/_verification.html")
    shown = page.render(found=answer, refused=None, image_names=names)
    return " ".join(shown.split())


def test_a_report_of_another_build_is_measured_by_its_uncertainties() -> None:
    slight = verification(in_uncertainties=0.04)
    assert "≈ It agrees within its uncertainties" in slight
    assert "Another build made it. The largest difference of a figure" in slight
    assert "<b>0.040</b> of its standard uncertainty" in slight
    assert "✕ It does not agree" in verification(in_uncertainties=1.2)
    assert "✕ It does not agree" in verification(in_uncertainties=0.04, build="0.1.0+a")
    assert "✕ It does not agree" in verification(in_uncertainties=None, relative_difference=None)
    assert "≈ It agrees" in verification(in_uncertainties=None, relative_difference=1e-4)


def test_what_differs_is_called_by_its_name_and_ids_that_nobody_knows_stay() -> None:
    known, gone = "mea_" + "1" * 26, "mea_" + "2" * 26
    inputs = [{"noun": "image", "name": one, "detail": "deleted"} for one in (known, gone)]
    shown = verification(
        in_uncertainties=1.2,
        changed={"changed_inputs": inputs, "changed_input_count": 2},
        image_names={known: "P1, cycle 2 (<a>.png)"},
    )
    assert f'<a href="/ui/measurements/{known}"><bdi>P1, cycle 2 (&lt;a&gt;.png)</bdi></a>: deleted' in shown
    assert f"<bdi>{gone}</bdi>: deleted" in shown


def test_who_signs_has_a_role_in_brackets(api: Any) -> None:
    signers = [{"name": "R. Meier", "role": "operator"}, {"name": "A. Ito", "role": None}]
    with api.installation.database.write() as records:
        new = NewReport(kind="camera", title=None, signatories=signers, paper="a4")
        report_id = order_report(records, api.make_session(), new).report.id
    shown = api.client.get(f"/ui/reports/{report_id}", headers=signed_in(api)).text
    assert "<bdi>R. Meier (operator)</bdi>, <bdi>A. Ito</bdi></dd>" in shown


def test_a_history_has_the_digits_that_its_points_or_limits_support() -> None:
    series: dict[str, Any] = {"test": 1, "of": "joint 1", "figure": "a_mm", "limits": None}
    points = [{**series, "low": 179.0, "high": 181.0}, {**series, "low": 179.9, "high": 180.3}]
    assert supported(series, points) == [179.9, 180.3]
    assert supported(series, [{**series, "low": None, "high": None}]) is None
    charted = {**series, "limits": {"centre": 5.0, "low": 2.0, "high": 8.0}}
    assert supported(charted, []) == [3.0, 7.0], "two standard deviations, of limits of three"


def test_a_history_has_a_column_of_the_data_sheet_where_figures_have_one(api: Any) -> None:
    joint = {"a_mm": 180.0, "alpha_deg": -90.0, "d_mm": 400.0, "theta_offset_deg": 0.0}
    robot = api.client.post("/v1/robots", json={"name": "KR", "joints": [joint] * 6}).json()["id"]
    store_filed(api, [content(1, robot=robot), joint_content(2, robot=robot)])
    while summarise_reports(api.installation.database):
        pass
    pages = [
        api.client.get(f"/ui/robots/{robot}/history?kind={kind}", headers=signed_in(api)).text
        for kind in ("repeatability", "kinematics")
    ]
    assert ["1 comparable session" in page for page in pages] == [True, True]
    assert ["Last minus data sheet" in page for page in pages] == [False, True]
