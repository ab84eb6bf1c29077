"""Reports that the disk had no room for while they were made."""

from __future__ import annotations

from typing import Any

import pytest

from app.errors import StorageFull
from app.services import reports
from tests.support.service.service import Api, wait_until


def test_a_report_that_could_not_be_stored_is_made_when_there_is_room(
    api: Api, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Refused before anything is computed: what is stored of it is the failure.
    templates = api.installation.settings.data_dir / "templates"
    templates.mkdir()
    (templates / "report.toml").write_text("not = [a template", encoding="utf-8")
    refused: list[str] = []

    def no_room(name: str) -> None:
        def refuse(*_given: Any, **_options: Any) -> None:
            refused.append(name)
            raise StorageFull

        monkeypatch.setattr(reports, name, refuse)

    no_room("save_failure")
    no_room("put_back")
    address = f"/v1/sessions/{api.make_session()}/reports"
    report_id = api.client.post(address, json={"kind": "camera"}).json()["id"]
    wait_until(lambda: "put_back" in refused, 120.0, "the report could be neither stored nor put back")
    assert refused == ["save_failure", "put_back"]
    monkeypatch.undo()

    api.service.report_maker.notify()  # as it does itself after a while
    wait_until(lambda: _document(api, report_id)["status"] == "failed", 120.0, "the report is made again")
    assert _document(api, report_id)["failure"]["code"] == "template_invalid"


def _document(api: Api, report_id: str) -> dict[str, Any]:
    document: dict[str, Any] = api.client.get(f"/v1/reports/{report_id}").json()
    return document
