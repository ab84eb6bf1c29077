"""A session's archive taken into an installation whose originals lie in a bucket, and out of it again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from app.services.archive import archive_session, restore_session
from tests.support.service.archives import members, rows, store
from tests.support.service.service import Api, ApiMaker

pytestmark = [pytest.mark.postgres, pytest.mark.slow]
FORMS = ("json", "pdf", "sig")


def answers(api: Api, session_id: str) -> dict[str, bytes]:
    """Every original, result and report of a session, as a client is answered."""
    reports = api.client.get(f"/v1/sessions/{session_id}/reports").json()["items"]
    paths = [f"/v1/reports/{report['id']}.{form}" for report in reports for form in FORMS]
    for one in api.measurements(session_id):
        paths += [f"/v1/measurements/{one['id']}/image", f"/v1/measurements/{one['id']}?include=points"]
    found = {}
    for path in [*paths, f"/v1/sessions/{session_id}/repeatability"]:
        response = api.client.get(path)
        assert response.status_code == 200, response.text
        found[path] = response.content
    return found


def test_a_session_goes_into_a_bucket_and_out_again_byte_for_byte(
    set_environment: dict[str, str], open_api: ApiMaker, tmp_path: Path
) -> None:
    places: dict[str, Any] = {
        "database_url": set_environment["GRIDPOSE_DATABASE_URL"],
        "blob_url": set_environment["GRIDPOSE_BLOB_URL"],
        "key_pepper": set_environment["GRIDPOSE_KEY_PEPPER"],
        "workers": 0,
    }
    local = {"database_url": None, "blob_url": None}
    first, second = tmp_path / "first.tar.gz", tmp_path / "second.tar.gz"
    with open_api(tmp_path / "here", **local) as here:
        session_id = store(here)
        archive_session(here.installation, session_id, first)
        expected, stored = answers(here, session_id), rows(here.installation)
    with open_api(tmp_path / "head", **places) as head:
        assert head.client.get(f"/v1/sessions/{session_id}").status_code == 404
        restore_session(head.installation, first)
        assert answers(head, session_id) == expected
        assert not list((tmp_path / "head" / "originals").glob("*/*")), "the originals lie in the bucket"
        archive_session(head.installation, session_id, second)
    originals = [one for one in members(first) if one[0].startswith("originals/")]
    assert originals == [one for one in members(second) if one[0].startswith("originals/")]
    with open_api(tmp_path / "there", **local) as there:
        restore_session(there.installation, second)
        assert answers(there, session_id) == expected
        assert rows(there.installation) == stored
