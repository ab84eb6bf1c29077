"""`gridpose doctor` names what is wrong with the database's server and with the bucket, and says what to do."""

from __future__ import annotations

from datetime import datetime, timedelta, tzinfo
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from app.blobs.objects import store_of
from app.errors import InstallationRefused, StorageFull
from app.records.database import Database
from app.services.inspection import bucket, database
from app.services.inspection.check_result import CheckResult, State
from app.services.installation import backends
from app.services.installation.context import ServiceContext
from app.settings import Settings
from tests.support.environment.pooler import TransactionPooler

pytestmark = [pytest.mark.postgres, pytest.mark.slow]


@pytest.fixture
def settings(set_environment: dict[str, str], machine: Path) -> Settings:
    """The settings of an installation that was opened once."""
    found = Settings(data_dir=machine, workers=0)
    ServiceContext.open(found).close()
    return found


def failures(results: list[CheckResult]) -> list[CheckResult]:
    found = [result for result in results if result.state is State.failed]
    assert all(result.advice for result in found), "each failure says what to do"
    return found


def test_a_whole_installation_has_no_failure(settings: Settings) -> None:
    in_bucket, in_database = list(bucket.check(settings)), list(database.check(settings))
    assert failures([*in_bucket, *in_database]) == []
    assert any("keeps the first of two objects" in result.detail for result in in_bucket)
    assert any("belong to installation" in result.detail for result in in_bucket)
    assert any("without a pooler" in result.detail for result in in_database)


@pytest.mark.parametrize(
    ("changed", "detail", "advice"),
    [
        ({"AWS_ACCESS_KEY_ID": "reader"}, "cannot be written", "AWS_ACCESS_KEY_ID"),
        ({"AWS_SECRET_ACCESS_KEY": "wrong"}, "cannot be written", "AWS_SECRET_ACCESS_KEY"),
    ],
)
def test_what_the_bucket_refuses(
    settings: Settings, monkeypatch: pytest.MonkeyPatch, changed: dict[str, str], detail: str, advice: str
) -> None:
    for name, value in changed.items():
        monkeypatch.setenv(name, value)
    store_of.cache_clear()
    (failure,) = failures(list(bucket.check(settings)))
    store_of.cache_clear()
    assert detail in failure.detail
    assert advice in (failure.advice or "")


def test_a_bucket_of_another_installation(settings: Settings, store: Any, tmp_path: Path) -> None:
    from tests.support.environment.postgres import new_database

    other_bucket = f"s3://{store.new_bucket()}/other"
    with new_database() as url:
        other = Settings(data_dir=tmp_path / "other", workers=0, database_url=url, blob_url=other_bucket)
        ServiceContext.open(other).close()
    mixed = Settings(data_dir=settings.data_dir, workers=0, blob_url=other_bucket)
    (failure,) = failures(list(bucket.check(mixed)))
    assert "belongs to installation" in failure.detail


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda url: url.set(port=9), id="no server"),
        pytest.param(lambda url: url.set(database="no_such_database"), id="no database"),
        pytest.param(lambda url: url.set(username="nobody_here"), id="no such role"),
    ],
)
def test_a_database_that_cannot_be_reached(settings: Settings, change: Any) -> None:
    assert settings.database_url is not None
    url = change(sa.make_url(settings.database_url)).render_as_string(hide_password=False)
    wrong = Settings(data_dir=settings.data_dir, workers=0, database_url=url)
    (failure,) = failures(list(database.check(wrong)))
    assert failure.detail.startswith("cannot be used: ")
    assert "GRIDPOSE_DATABASE_URL" in (failure.advice or "")


def test_a_pooler_in_transaction_mode_is_named_and_refused(settings: Settings, tmp_path: Path) -> None:
    assert settings.database_url is not None
    with TransactionPooler(settings.database_url) as pooler:
        pooled = Settings(data_dir=tmp_path / "pooled", workers=0, database_url=pooler.url)
        (failure,) = failures(list(database.check(pooled)))
        assert "pooler in transaction mode" in failure.detail
        assert "session mode" in (failure.advice or "")
        with pytest.raises(InstallationRefused) as caught:
            ServiceContext.open(pooled)
        assert caught.value.code == "database_pooled"


def test_a_clock_that_is_not_the_servers_is_refused(
    settings: Settings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Ahead(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> Any:
            return datetime.now(tz) + timedelta(minutes=5)

    monkeypatch.setattr(backends, "datetime", Ahead)
    (failure,) = failures(list(database.check(settings)))
    assert "300 s ahead of the database server's" in failure.detail
    assert "NTP" in (failure.advice or "")
    skewed = Settings(data_dir=tmp_path / "skewed", workers=0, database_url=settings.database_url)
    with pytest.raises(InstallationRefused) as caught:
        ServiceContext.open(skewed)
    assert caught.value.code == "clock_skewed"


def test_a_server_whose_disk_is_full_is_no_defect(settings: Settings) -> None:
    from psycopg.errors import DiskFull

    assert settings.database_url is not None
    opened = Database(settings.database_url)
    said = DiskFull('could not extend file "base/1/2": No space left on device')
    with pytest.raises(StorageFull), opened.write():
        raise sa.exc.OperationalError("INSERT", {}, said)
    opened.dispose()
