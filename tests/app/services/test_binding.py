"""Database, data folder and pepper of one installation are opened together, and otherwise not at all."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from app.errors import InstallationRefused
from app.records import migrations
from app.records.audit import list_entries
from app.records.database import Database
from app.records.ids import new_id
from app.records.tables import ApiKey, Pose, Session, Target
from app.records.tables import Installation as InstallationRow
from app.records.tables import Measurement as MeasurementRow
from app.services.installation.context import ServiceContext
from app.services.installation.identity import read_identity, write_identity
from app.services.keys import create_key, find_key
from app.settings import Settings
from tests.support.environment.postgres import EITHER_DATABASE
from tests.support.service.originals import original_path

NOW = datetime(2026, 1, 31, tzinfo=UTC)
Make = Callable[..., Settings]


@pytest.fixture(params=EITHER_DATABASE)
def make_settings(request: pytest.FixtureRequest, tmp_path: Path) -> Make:
    """Make settings with a folder of the given name, and the same database for all of them."""
    url = f"sqlite:///{tmp_path / 'x.sqlite3'}"
    if request.param == "postgresql":
        url = request.getfixturevalue("postgres_url")

    def make(folder: str = "data", **changes: Any) -> Settings:
        return Settings(**{"data_dir": tmp_path / folder, "database_url": url, "workers": 0, **changes})

    return make


def opened(settings: Settings, **how: bool) -> tuple[str, bytes]:
    """Open and close; return the installation's id and its pepper."""
    installation = ServiceContext.open(settings, **how)
    with installation.database.read() as records:
        row = records.get_one(InstallationRow, 1)
    installation.close()
    identity = read_identity(settings.data_dir)
    assert identity is not None
    assert (identity.id, identity.state) == (row.id, "made")
    assert identity.created_at == row.created_at
    return row.id, installation.pepper


def with_key(settings: Settings) -> str:
    installation = ServiceContext.open(settings)
    key = create_key(installation, "k", "admin").secret_key
    installation.close()
    return key


def refused(settings: Settings, **how: bool) -> str:
    with pytest.raises(InstallationRefused) as caught:
        ServiceContext.open(settings, **how)
    assert caught.value.advice
    return caught.value.code


def test_folder_and_database_carry_one_id_from_the_first_start_on(make_settings: Make) -> None:
    first = opened(make_settings())
    assert opened(make_settings()) == first
    assert opened(make_settings(), init=False) == first


def test_first_starts_at_once_make_one_installation(make_settings: Make) -> None:
    settings = make_settings()
    with ThreadPoolExecutor(4) as pool:
        found = set(pool.map(lambda _: opened(settings), range(4)))
    assert len(found) == 1


def test_another_folder_is_refused_and_gets_no_pepper(make_settings: Make, tmp_path: Path) -> None:
    """It answered `original_missing`, made a new pepper and so locked every key out."""
    key = with_key(make_settings())
    assert refused(make_settings("other")) == "installation_not_in_folder"
    assert not (tmp_path / "other" / "key-pepper").exists()
    installation = ServiceContext.open(make_settings())
    assert find_key(installation, key) is not None
    installation.close()


def test_folder_and_database_of_two_installations_are_refused(make_settings: Make, tmp_path: Path) -> None:
    opened(make_settings())
    opened(Settings(data_dir=tmp_path / "other", workers=0))
    assert refused(make_settings("other")) == "installation_mismatch"
    assert refused(make_settings("other"), adopt=True) == "installation_mismatch"


def test_an_empty_database_for_an_installations_folder_is_refused(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path / "data", workers=0)
    opened(settings)
    database = tmp_path / "data" / "gridpose.sqlite3"
    database.rename(tmp_path / "moved")
    assert refused(settings) == refused(settings, init=False) == "installation_not_in_database"
    assert not database.exists(), "refusing makes nothing"
    opened(settings, adopt=True)


def test_a_folder_without_an_installation_is_left_as_it_is(make_settings: Make, tmp_path: Path) -> None:
    assert refused(make_settings("none"), init=False) == "installation_missing"
    assert not (tmp_path / "none").exists()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").touch()
    opened(make_settings())
    assert refused(make_settings("other"), init=False) == "installation_missing"
    assert [path.name for path in (tmp_path / "other").iterdir()] == ["notes.txt"]


def test_a_folder_of_something_else_is_neither_used_nor_closed(make_settings: Make, tmp_path: Path) -> None:
    """As the superuser, a service that was given /tmp closed it to everyone."""
    folder = tmp_path / "shared"
    folder.mkdir()
    (folder / "other-program").touch()
    folder.chmod(0o1777)
    assert refused(make_settings("shared")) == "folder_foreign"
    assert folder.stat().st_mode & 0o7777 == 0o1777
    assert [path.name for path in folder.iterdir()] == ["other-program"]


def test_a_folder_of_its_own_may_hold_what_is_no_content(make_settings: Make, tmp_path: Path) -> None:
    """A disk's `lost+found`, and what a first start left that died early."""
    (tmp_path / "disk" / "lost+found").mkdir(parents=True)
    for name in ("service.log", "migrate.lock", "head.lock", "installation.json.0123456789abcdef"):
        (tmp_path / "disk" / name).touch()
    opened(make_settings("disk"))


def test_a_start_that_died_in_between_is_completed(make_settings: Make) -> None:
    settings = make_settings()
    installation_id, pepper = opened(settings)
    identity = read_identity(settings.data_dir)
    assert identity is not None
    making = type(identity)(identity.id, identity.created_at, "making")
    # Died after the commit.
    write_identity(settings.data_dir, making)
    assert refused(settings, init=False) == "installation_missing"
    assert opened(settings) == (installation_id, pepper)
    # Died before it.
    write_identity(settings.data_dir, making)
    database = Database(settings.effective_database_url)
    with database.write() as records:
        records.execute(sa.delete(InstallationRow))
    database.dispose()
    assert opened(settings)[0] == installation_id


def test_a_missing_pepper_is_refused_where_keys_are_in_force(make_settings: Make) -> None:
    settings = make_settings()
    key = with_key(settings)
    pepper = settings.data_dir / "key-pepper"
    kept = pepper.read_bytes()
    for content in (None, b""):
        pepper.unlink(missing_ok=True)
        if content is not None:
            pepper.write_bytes(content)
        assert refused(settings) == "pepper_missing"
    stated = make_settings(key_pepper=kept.decode())
    installation = ServiceContext.open(stated)
    assert find_key(installation, key) is not None
    installation.close()


def test_another_pepper_is_refused_until_it_is_adopted(make_settings: Make) -> None:
    former = with_key(make_settings())
    changed = make_settings(key_pepper="another secret of many characters")
    assert refused(changed) == "pepper_changed"
    installation = ServiceContext.open(changed, adopt=True)
    with installation.database.read() as records:
        keys = records.scalars(sa.select(ApiKey)).all()
        assert all(key.revoked_at is not None for key in keys)
        row = records.get_one(InstallationRow, 1)
        (entry,) = list_entries(records, limit=10, cursor=None)[0]
    assert (entry.actor, entry.action) == ("cli", "adopt_installation")
    assert entry.object_ids == [row.id, *(key.id for key in keys)]
    assert find_key(installation, former) is None
    later = create_key(installation, "later", "admin").secret_key
    installation.close()
    installation = ServiceContext.open(changed)
    assert find_key(installation, later) is not None
    installation.close()
    assert refused(make_settings()) == "pepper_changed"


def test_without_keys_a_pepper_may_change(make_settings: Make) -> None:
    opened(make_settings())
    opened(make_settings(key_pepper="another secret of many characters"))


def test_a_lost_folder_is_replaced_on_demand(make_settings: Make) -> None:
    before = with_key(make_settings())
    installation_id, _ = opened(make_settings())
    assert refused(make_settings("new")) == "installation_not_in_folder"
    assert opened(make_settings("new"), adopt=True)[0] == installation_id
    installation = ServiceContext.open(make_settings("new"))
    assert find_key(installation, before) is None
    installation.close()


def as_before_ids(settings: Settings) -> None:
    """Take an installation back to the schema before there were ids."""
    database = Database(settings.effective_database_url)
    migrations.downgrade(database, "0004")
    database.dispose()
    (settings.data_dir / "installation.json").unlink()


def store_image(settings: Settings) -> Path:
    """Store a measurement and its original; return the original's path."""
    session, target, sha256 = new_id("ses"), new_id("tgt"), "ab" * 32
    installation = ServiceContext.open(settings)
    with installation.database.write() as records:
        fields = {"kind": "chessboard", "columns": 9, "rows": 6, "pitch_mm": 1.0, "legacy_layout": False}
        records.add(Target(id=target, name="t", created_at=NOW, **fields))
        records.add(Session(id=session, name="s", created_at=NOW))
        records.flush()
        records.add(Pose(id=new_id("pos"), session_id=session, pose_id="P1"))
        records.flush()
        records.add(
            MeasurementRow(
                id=new_id("mea"),
                session_id=session,
                pose_id="P1",
                target_id=target,
                focus_group="default",
                received_at=NOW,
                sha256=sha256,
                bytes=1,
                image_format="png",
                image_width_px=1,
                image_height_px=1,
                status="queued",
                attempts=0,
            )
        )
    path = original_path(installation, sha256)
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(b"x")
    installation.close()
    return path


def test_an_installation_from_before_ids_gets_one_when_it_is_opened(make_settings: Make) -> None:
    settings = make_settings()
    key = with_key(settings)
    store_image(settings)
    as_before_ids(settings)
    opened(settings, init=False)
    installation = ServiceContext.open(settings)
    assert find_key(installation, key) is not None
    installation.close()


def test_a_database_from_before_ids_is_not_taken_by_another_folder(make_settings: Make) -> None:
    settings = make_settings()
    with_key(settings)
    store_image(settings)
    as_before_ids(settings)
    assert refused(make_settings("other", key_pepper="x" * 32)) == "originals_elsewhere"
    opened(settings)


def test_a_folder_from_before_ids_without_its_pepper_is_refused(make_settings: Make) -> None:
    settings = make_settings()
    with_key(settings)
    as_before_ids(settings)
    (settings.data_dir / "key-pepper").unlink()
    assert refused(settings) == "pepper_missing"


def test_the_way_back_and_up_again_keeps_the_id(make_settings: Make) -> None:
    settings = make_settings()
    before = opened(settings)
    database = Database(settings.effective_database_url)
    migrations.downgrade(database, "0004")
    database.dispose()
    assert opened(settings) == before


@pytest.mark.parametrize(
    "content", ["", "{}", "[]", '{"id": "x", "created_at": "2026-01-01", "state": "made"}']
)
def test_an_unreadable_identity_is_refused(tmp_path: Path, content: str) -> None:
    settings = Settings(data_dir=tmp_path, workers=0)
    opened(settings)
    (tmp_path / "installation.json").write_text(content)
    assert refused(settings) == "installation_mismatch"
