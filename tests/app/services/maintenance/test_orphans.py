"""Files that no row names are removed after their grace, and nothing else is."""

from __future__ import annotations

import hashlib
import os
import time
from typing import Any

import pytest
import sqlalchemy as sa

from app.blobs.local import LocalBlobs
from app.services.maintenance.chores import Maintenance
from app.services.maintenance.orphans import FEW, GRACE_S, MAX_STEP_S, STATE
from app.services.originals import finish_removals
from tests.support.service.originals import fill, forget, new_sweep, originals, recorded


def make_orphans(api: Any, count: int) -> set[str]:
    """Put files there that no row names, written long ago."""
    names = {hashlib.sha256(b"%d" % number).hexdigest() for number in range(count)}
    for name in names:
        path = api.installation.blobs.path(name)
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"nobody's")
        os.utime(path, (0, 0))
    return names


def sweep_for(api: Any, start_s: float, running_s: float) -> int:
    """Look for orphans every hour, beginning at `start_s`, each time as a new process; return how many went."""
    rounds = int(running_s // MAX_STEP_S) + 1
    return sum(new_sweep(api).run(start_s + number * MAX_STEP_S) for number in range(rounds))


def test_orphans_go_after_a_day_as_orphans_and_not_before(any_api: Any, grey_png: bytes) -> None:
    """The grace used to count from the writing of the file, which is long ago for all but those just uploaded."""
    _, kept = fill(any_api, grey_png)
    blobs: LocalBlobs = any_api.installation.blobs
    for name in kept:
        os.utime(blobs.path(name), (0, 0))
    orphans = make_orphans(any_api, 3)
    (blobs.root / "aa").mkdir(exist_ok=True)
    (blobs.root / "aa" / "notes.txt").write_text("not ours")
    now_s = time.time()
    assert sweep_for(any_api, now_s, GRACE_S) == 0
    assert originals(any_api) == {*kept, "notes.txt", *orphans}
    assert sweep_for(any_api, now_s + GRACE_S, 2 * MAX_STEP_S) == 3
    assert originals(any_api) == {*kept, "notes.txt"}
    assert not (any_api.installation.settings.data_dir / STATE).exists()


def test_an_orphan_that_a_row_names_again_begins_anew(api: Any, grey_png: bytes) -> None:
    api.put_image(api.make_session(), grey_png + b"another")
    name = hashlib.sha256(grey_png).hexdigest()
    path = api.installation.blobs.path(name)
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(grey_png)
    now_s = time.time()
    assert sweep_for(api, now_s, GRACE_S) == 0
    session_id = api.make_session()
    api.put_image(session_id, grey_png)
    assert sweep_for(api, now_s + GRACE_S, GRACE_S) == 0
    with api.installation.database.write() as records:
        records.execute(sa.text("DELETE FROM sessions WHERE id = :id"), {"id": session_id})
    assert sweep_for(api, now_s + 2 * GRACE_S, GRACE_S) == 0
    assert name in originals(api)


@pytest.mark.parametrize("content", [b"", b"[]", b'{"at_s": 1}', b'{"at_s": 1, "known_s": 7}'])
def test_no_step_of_the_clock_and_no_damaged_file_shortens_the_grace(
    api: Any, grey_png: bytes, content: bytes
) -> None:
    api.put_image(api.make_session(), grey_png)
    orphans = make_orphans(api, 1)
    now_s = time.time()
    for number in range(12):
        assert new_sweep(api).run(now_s + number * 100 * GRACE_S) == 0
        assert new_sweep(api).run(now_s - number * 100 * GRACE_S) == 0
    (api.installation.settings.data_dir / STATE).write_bytes(content)
    assert sweep_for(api, now_s, GRACE_S) == 0
    assert orphans <= originals(api)


def test_an_empty_database_that_was_adopted_removes_no_original(
    api: Any, grey_png: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    """The first round used to delete every original older than a day."""
    orphans = make_orphans(api, 2)
    capsys.readouterr()
    sweep, now_s = new_sweep(api), time.time()
    assert [sweep.run(now_s + number * MAX_STEP_S) for number in range(50)] == [0] * 50
    assert originals(api) == orphans
    said = capsys.readouterr()
    assert (
        1 <= (said.out + said.err).count("orphans_kept") <= 2
    )  # the application's own first round may be one
    # One upload does not make a database that names most of the originals.
    kept = api.put_image(api.make_session(), grey_png).json()["sha256"]
    assert sweep_for(api, now_s + 3 * GRACE_S, 2 * GRACE_S) == 0
    assert originals(api) == {kept, *orphans}


def test_an_older_database_put_back_removes_no_original(api: Any, grey_png: bytes) -> None:
    fill(api, grey_png, FEW + 1)
    orphans = make_orphans(api, FEW + 1)
    assert sweep_for(api, time.time(), 3 * GRACE_S) == 0
    assert orphans <= originals(api)


def test_deletions_under_way_are_no_orphans(any_api: Any, grey_png: bytes) -> None:
    fill(any_api, grey_png, 1)
    session_id, hashes = fill(any_api, grey_png + b"x", FEW + 2)
    forget(any_api, session_id)
    orphans = make_orphans(any_api, 1)
    assert sweep_for(any_api, time.time(), GRACE_S + MAX_STEP_S) == 1
    assert hashes <= originals(any_api)
    assert not orphans & originals(any_api)


def test_a_clock_set_forward_makes_nothing_old(monkeypatch: pytest.MonkeyPatch) -> None:
    times: list[float] = []
    maintenance = Maintenance([("look", lambda turn: times.append(turn.now_s))])
    maintenance.run_once()
    monkeypatch.setattr(time, "time", lambda: times[0] + 30 * GRACE_S)
    maintenance.run_once()
    assert times[1] - times[0] < GRACE_S / 2


def test_an_upload_in_progress_is_never_swept(api: Any) -> None:
    blobs: LocalBlobs = api.installation.blobs
    staged = blobs.stage()
    staged.write(b"half an image")
    left = staged.path.with_name("left-by-an-upload-that-died")
    left.write_bytes(b"half")
    for path in (staged.path, left):
        os.utime(path, (0, 0))
    assert new_sweep(api).run(time.time()) == 1
    assert staged.path.exists()
    assert not left.exists()
    staged.discard()
    assert list(staged.path.parent.iterdir()) == []


def test_stopping_is_heard_by_a_chore_that_takes_long(any_api: Any, grey_png: bytes) -> None:
    session_id, hashes = fill(any_api, grey_png)
    installation = any_api.installation
    forget(any_api, session_id)
    assert finish_removals(installation.database, installation.blobs, stopped=lambda: True) == 0
    assert new_sweep(any_api).run(2e10, stopped=lambda: True) == 0
    assert recorded(any_api) == hashes
    assert finish_removals(installation.database, installation.blobs) == len(hashes)
