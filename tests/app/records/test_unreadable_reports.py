"""Reports whose rows were damaged behind the service's back: each is the trouble of nobody else."""

from __future__ import annotations

from typing import Any

import pytest
import sqlalchemy as sa

from app.services.reports import NewReport, order_report
from tests.support.service.service import Api, assert_problem


@pytest.mark.parametrize(
    "assignment",
    [
        "signatories = '[1, 2'",
        "signatories = '[{\"name\": 1}]'",
        "failure = '{\"code\": 1}'",
        "signature = '[]'",
    ],
)
def test_a_damaged_report_is_refused_and_the_others_are_listed(api: Api, assignment: str) -> None:
    api.service.report_maker.stop()
    session_id = api.make_session()
    new = NewReport(kind="camera", title=None, signatories=[], paper="a4")
    with api.installation.database.write() as records:
        bad, good = (order_report(records, session_id, new).report.id for _ in range(2))
    with api.installation.database.engine.begin() as connection:
        values: dict[str, Any] = {"id": bad}
        connection.execute(sa.text(f"UPDATE reports SET {assignment} WHERE id = :id"), values)
    for path in ("", ".pdf", ".sig"):
        assert_problem(api.client.get(f"/v1/reports/{bad}{path}"), 409, "row_unreadable")
    listed = api.client.get("/v1/reports").json()
    assert [item["id"] for item in listed["items"]] == [good]
    assert [warning["code"] for warning in listed["warnings"]] == ["row_unreadable"]
