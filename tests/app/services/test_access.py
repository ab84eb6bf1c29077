"""What is kept in memory of keys and sessions: never older than the database, whoever changed it."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import pytest
import sqlalchemy as sa

from app.records.database import Database
from app.services.installation.access import AccessCache
from app.services.keys import change_key, create_key, recall_key, revoke_key
from app.services.measurements import recall_targets
from tests.support.service.service import access_version


@pytest.fixture
def elsewhere(api: Any) -> Any:
    """Another process's connections to the same database."""
    database = Database(api.installation.database.url)
    yield database
    database.dispose()


def execute(database: Database, statement: str) -> None:
    with database.engine.begin() as connection:
        connection.exec_driver_sql(statement)


def test_every_change_of_what_is_kept_raises_the_version(any_api: Any) -> None:
    """Also after migrations that made a table anew, which drops its triggers."""
    key = create_key(any_api.installation, "k", "upload", bytes_per_day=10).key.id
    session_id = any_api.make_session()
    other = any_api.make_target()
    database = any_api.installation.database
    moment = "2030-01-01 00:00:00"
    changes = [
        f"UPDATE api_keys SET {column} = {value} WHERE id = '{key}'"
        for column, value in (
            ("name", "'x'"),
            ("scope", "'read'"),
            ("secret_hmac", f"'{'0' * 64}'"),
            ("expires_at", f"'{moment}'"),
            ("revoked_at", f"'{moment}'"),
            ("session_ids", f"'[\"{session_id}\"]'"),
            ("bytes_per_day", "5"),
        )
    ]
    changes += [
        f"DELETE FROM api_keys WHERE id = '{key}'",
        f"INSERT INTO session_targets VALUES ('{session_id}', 1, '{other}')",
        f"UPDATE session_targets SET position = 2 WHERE target_id = '{other}'",
        f"DELETE FROM session_targets WHERE target_id = '{other}'",
        f"DELETE FROM sessions WHERE id = '{session_id}'",
    ]
    for change in changes:
        before = access_version(database)
        execute(database, change)
        assert access_version(database) > before, change


def test_uploads_and_the_use_of_keys_leave_what_is_kept(api: Any, grey_png: bytes) -> None:
    key = create_key(api.installation, "k", "upload", bytes_per_day=10**6)
    headers = {"Authorization": f"Bearer {key.secret_key}"}
    session_id = api.make_session()
    api.client.headers.update(headers)
    before = api.installation.database.access_version()
    assert api.put_image(session_id, grey_png).status_code == 202
    api.service.key_use.write()
    assert api.installation.database.access_version() == before
    assert recall_key(api.installation, key.secret_key) is not None
    assert recall_targets(api.installation, session_id) is not None


def test_a_key_revoked_elsewhere_opens_nothing_from_the_next_request_on(api: Any, elsewhere: Any) -> None:
    key = create_key(api.installation, "k", "read")
    headers = {"Authorization": f"Bearer {key.secret_key}"}
    for _ in range(2):
        assert api.client.get("/v1/targets", headers=headers).status_code == 200
    assert recall_key(api.installation, key.secret_key) is not None, "it is kept"
    now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S.%f")
    execute(elsewhere, f"UPDATE api_keys SET revoked_at = '{now}' WHERE id = '{key.key.id}'")
    assert api.client.get("/v1/targets", headers=headers).status_code == 401


def test_a_kept_key_is_checked_whole(api: Any) -> None:
    key = create_key(api.installation, "k", "read", expires_in=None)
    api.client.get("/v1/targets", headers={"Authorization": f"Bearer {key.secret_key}"})
    assert recall_key(api.installation, key.secret_key) is not None
    wrong = key.secret_key[:-1] + ("0" if key.secret_key[-1] != "0" else "1")
    assert recall_key(api.installation, wrong) is None
    facts = api.installation.access.current()
    assert facts is not None
    facts.keys[key.key.id].expires_at = datetime(2020, 1, 1, tzinfo=UTC)
    assert recall_key(api.installation, key.secret_key) is None, "it expires while it is kept"


def test_a_changed_quota_holds_for_the_next_upload(api: Any, grey_png: bytes) -> None:
    key = create_key(api.installation, "k", "upload")
    session_id = api.make_session()
    api.client.headers["Authorization"] = f"Bearer {key.secret_key}"
    assert api.put_image(session_id, grey_png).status_code == 202
    change_key(api.installation, key.key.id, {"bytes_per_day": 1})
    assert api.put_image(session_id, grey_png, "P2").status_code == 429
    change_key(api.installation, key.key.id, {"bytes_per_day": 10**6})
    assert api.put_image(session_id, grey_png, "P2").status_code == 202
    revoke_key(api.installation, key.key.id)
    assert api.put_image(session_id, grey_png, "P3").status_code == 401


def test_targets_changed_elsewhere_hold_for_the_next_upload(
    api: Any, elsewhere: Any, grey_png: bytes
) -> None:
    one, two = api.make_target(), api.make_target(columns=7)
    session_id = api.make_session(one)
    assert api.put_image(session_id, grey_png, target_id=two).status_code == 422
    execute(elsewhere, f"UPDATE session_targets SET target_id = '{two}' WHERE session_id = '{session_id}'")
    assert api.put_image(session_id, grey_png, target_id=one).status_code == 422
    assert api.put_image(session_id, grey_png, target_id=two).status_code == 202
    execute(elsewhere, f"DELETE FROM sessions WHERE id = '{session_id}'")
    assert api.put_image(session_id, grey_png, "P2").status_code == 404


def test_facts_end_with_their_version(api: Any) -> None:
    cache = AccessCache(api.installation.database)
    first = cache.current()
    assert first is not None
    first.targets["s"] = ("t",)
    assert cache.current() is first
    api.make_target()
    assert cache.current() is first, "nothing that is kept was changed"
    api.make_session()
    later = cache.current()
    assert later is not None
    assert later is not first
    assert not later.targets


def test_nothing_is_kept_where_the_version_cannot_be_read(api: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on PostgreSQL, where a question takes too long for the event loop."""
    monkeypatch.setattr(Database, "access_version", lambda _: None)
    assert api.installation.access.current() is None
    assert api.client.get("/v1/targets").status_code == 200
    session_id = api.make_session()
    assert api.put_image(session_id, b"x").status_code == 415
    with api.installation.database.read() as records:
        assert records.scalar(sa.text("SELECT version FROM access_version")) > 0
