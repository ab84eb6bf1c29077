"""Installations of released versions: restored from their backups, migrated, read, and reported on."""

from __future__ import annotations

import json
import tarfile
from pathlib import Path
from typing import Any

import pytest

from app.records.numbers import rounded
from app.reports.signature import check_file
from app.services.backup import restore_backup
from app.settings import Settings
from tests.support.service.service import Api, ApiMaker, wait_until

pytestmark = pytest.mark.slow  # a process of the analyses loads the numerics
BACKUPS = sorted((Path(__file__).parents[2] / "reference" / "releases").glob("*.tar.gz"))
STORED = ("status", "pose_id", "cycle", "sha256", "bytes", "points")
"""What a measurement's document holds of what was stored, in every version."""


def test_there_is_a_backup_of_a_release() -> None:
    assert BACKUPS


@pytest.mark.parametrize("path", BACKUPS, ids=lambda path: path.name.removesuffix(".tar.gz"))
def test_an_installation_of_a_release_is_read_and_reported_on(
    open_api: ApiMaker, tmp_path: Path, path: Path
) -> None:
    with tarfile.open(path) as archive:
        archive.extractall(tmp_path / "backup", filter="data")
    then = json.loads((tmp_path / "backup" / "answers.json").read_text(encoding="utf-8"))
    restore_backup(tmp_path / "backup", Settings(data_dir=tmp_path / "data", workers=0))
    with open_api(tmp_path / "data") as api:
        api.client.headers["Authorization"] = then["authorization"]  # keys of that time are valid
        for measurement_id, before in then["measurements"].items():
            now = api.measurement(measurement_id, include="points")
            assert {name: now[name] for name in STORED} == {name: rounded(before[name]) for name in STORED}
            original = api.client.get(f"/v1/measurements/{measurement_id}/image")
            assert original.status_code == 200
            assert len(original.content) == before["bytes"]
        session_id = then["session_id"]
        table = api.client.get(f"/v1/sessions/{session_id}/repeatability").json()
        # The estimators may have changed since; what they find may not have moved.
        for before, now in zip(then["repeatability"]["poses"], table["poses"], strict=True):
            assert now["cycles"] == before["cycles"]
            reading = now["repeatability"]["rp_l_mm"]
            assert reading == pytest.approx(before["repeatability"]["rp_l_mm"], rel=0.01)
        _report(api, session_id, len(then["measurements"]))


def _report(api: Api, session_id: str, images: int) -> None:
    """Make a report of the migrated session; every figure, original and form is verified."""
    ordered = api.client.post(f"/v1/sessions/{session_id}/reports", json={"kind": "repeatability"}).json()
    address = f"/v1/reports/{ordered['id']}"

    def read() -> dict[str, Any]:
        found: dict[str, Any] = api.client.get(address).json()
        return found

    wait_until(lambda: read()["status"] in ("succeeded", "failed"), 300.0, "the report is made")
    report = read()
    assert report["status"] == "succeeded", report["failure"]
    signature = api.client.get(f"{address}.sig").content
    for form in report["forms"]:
        assert check_file(api.client.get(f"{address}.{form['form']}").content, signature).is_valid
    verified = api.client.get(f"{address}/verify").json()
    # Grid points of that release and of today agree to 1e-6 px: a detection that moves them has to say so here.
    assert verified["agrees"], verified
    assert verified["figures_equal"] == verified["figures"] > 50
    assert verified["originals"]["measured"] == images
