"""What a text may hold is said by its form; days exist, and a data sheet's figures are above zero."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from app.http.invalid_fields import FORMS
from tests.support.service.service import TARGET, assert_problem


def test_every_form_of_the_contract_has_words(api: Any) -> None:
    found: set[str] = set()

    def collect(node: Any) -> None:
        if isinstance(node, dict):
            found.update([node["pattern"]] if isinstance(node.get("pattern"), str) else [])
            node = list(node.values())
        for item in node if isinstance(node, list) else ():
            collect(item)

    collect(api.client.get("/openapi.json").json())
    assert found == set(FORMS)


def test_a_form_is_named(api: Any) -> None:
    session = f"/v1/sessions/{api.make_session()}"
    named = api.client.post(f"{session}/poses", json=[{"pose_id": ".a"}])
    lined = api.client.post("/v1/targets", json={**TARGET, "name": "two\nlines"})
    messages = [assert_problem(one, 422)["errors"][0]["message"] for one in (named, lined)]
    assert all(message in FORMS.values() for message in messages)
    assert messages[0] != messages[1]


@pytest.mark.parametrize("day", ["2026-02-30", "2026-13-01", "2099-01-01", timedelta(days=3)], ids=str)
def test_a_day_of_issue_exists_and_is_past(api: Any, day: str | timedelta) -> None:
    stated = day if isinstance(day, str) else (datetime.now(UTC) + day).date().isoformat()
    certificate = {
        "issued_on": stated,
        "pitch_x_mm": 25.0,
        "pitch_y_mm": 25.0,
        "standard_uncertainty": {"pitch_x_mm": 0.001, "pitch_y_mm": 0.001},
    }
    refused = api.client.post("/v1/targets", json={**TARGET, "certificate": certificate})
    assert assert_problem(refused, 422)["errors"][0]["field"] == "certificate.issued_on"
    address = f"/v1/targets/{api.make_target()}"
    assert_problem(api.client.patch(address, json={"certificate": certificate}), 422)
    issued = {**certificate, "issued_on": datetime.now(UTC).date().isoformat()}
    assert api.client.patch(address, json={"certificate": issued}).status_code == 200


@pytest.mark.parametrize("name", ["datasheet_repeatability_mm", "datasheet_accuracy_mm"])
def test_a_data_sheet_states_more_than_zero(api: Any, name: str) -> None:
    joint = {"a_mm": 100.0, "alpha_deg": 0.0, "d_mm": 0.0}
    robot = {"name": "arm", "joints": [joint], name: 0}
    assert assert_problem(api.client.post("/v1/robots", json=robot), 422)["errors"][0]["field"] == name
    assert api.client.post("/v1/robots", json={**robot, name: None}).status_code == 201
