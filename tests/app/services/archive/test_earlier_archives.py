"""Archives of earlier versions are restored by this one, and their reports verify."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from app.reports.signature import check_file
from app.services.archive import restore_session
from tests.reference.archives.make import FOLDER, KINDS
from tests.support.service.service import ApiMaker

pytestmark = pytest.mark.slow  # a process of the analyses loads the numerics
CORRECTED = re.compile(
    r"\.distances\[.*\.(standard_uncertainty_mm|interval_mm)|\.warnings\[target_shape_dominates\]"
    # Cameras and dh: what prints may depart by in shape, and that their scale is taken as exact.
    r"|^intrinsics\..*(standard_uncertainty|interval_95|covariance|grade|px)|\.warnings\[scale_taken_as_exact\]"
    r"|^repeatability\.groups\[\d+\]\.(standard_uncertainty|interval_95|grade)"
)
"""What versions since state otherwise on purpose: the CHANGELOG has each."""
MAX_CHANGE, MAX_COVARIANCE_CHANGE = 2e-3, 0.05
"""Relative: priors on the lens that are wider since move figures of a session of two poses by less than this."""
ARCHIVES = sorted(FOLDER.glob("*.tar.gz"))


def test_there_is_an_archive() -> None:
    assert ARCHIVES


@pytest.mark.parametrize("path", ARCHIVES, ids=lambda path: path.name.removesuffix(".tar.gz"))
def test_reports_of_an_earlier_version_are_read_and_verify(open_api: ApiMaker, path: Path) -> None:
    with open_api() as api:
        restored = restore_session(api.installation, path)
        session = restored.manifest.session_id
        for measurement in api.measurements(session):
            assert api.measurement(measurement["id"], include="points")["points"]
        found = api.client.get(f"/v1/sessions/{session}/reports").json()["items"]
        assert sorted(report["kind"] for report in found) == sorted(KINDS)
        for report in found:
            address = f"/v1/reports/{report['id']}"
            signature = api.client.get(f"{address}.sig").content
            for form in report["forms"]:
                content = api.client.get(f"{address}.{form['form']}").content
                assert check_file(content, signature).is_valid
            # The points of this session were simulated: it never had originals.
            verified = api.client.get(f"{address}/verify", params={"originals": "false"}).json()
            otherwise = [one for one in verified["differences"] if not CORRECTED.search(one["path"])]
            assert all(one["relative_difference"] is not None for one in otherwise), verified
            for one in otherwise:
                limit = MAX_COVARIANCE_CHANGE if ".covariance[" in one["path"] else MAX_CHANGE
                assert one["relative_difference"] < limit, one
            assert verified["agrees"] == (not verified["differences"])
            # That version's reports state no labelling.
            assert (verified["is_current"], verified["recomputed_from"]) == (True, "report_and_session")
            assert verified["current_values"] == ["image.labelling"]
            assert verified["core_version_then"] != verified["core_version_now"]
