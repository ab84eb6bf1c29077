"""The session's mark: it changes with every change that an analysis can see, and saves the analysis where none was."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from itertools import count
from typing import Any

import pytest
import sqlalchemy as sa

from app.analyses.answer_cache import AnswerCache
from app.analyses.inputs.change_token import read_change_token
from app.records.codec import content_hash
from app.records.database import Database
from app.records.ids import new_id
from app.records.statements import Statement
from app.records.tables import MeasuredPose, Measurement, Pose, Result, Session, SessionTarget, Target
from tests.support.sessions.stored_sessions import Store, new_session, shoot, with_fields


def mark(api: Any, session: str) -> str:
    with api.installation.database.read() as records:
        return read_change_token(records, session)


def _status(status: str, **fields: Any) -> Callable[[Any, str, str], None]:
    def change(records: Any, _session: str, first: str) -> None:
        records.execute(sa.update(Measurement).where(Measurement.id == first).values(status=status, **fields))

    return change


def _finished_again(records: Any, _session: str, first: str) -> None:
    records.execute(
        sa.update(Measurement).where(Measurement.id == first).values(finished_at=datetime.now(UTC))
    )


def _pose(records: Any, session: str, _first: str) -> None:
    # The least change of a number counts.
    records.execute(sa.update(Pose).where(Pose.session_id == session).values(roll_deg=0.1))
    before = read_change_token(records, session)
    records.execute(sa.update(Pose).where(Pose.session_id == session).values(roll_deg=0.1 + 2.0**-56))
    assert read_change_token(records, session) != before


def _lens(records: Any, session: str, _first: str) -> None:
    lens = {"focal_length_mm": 8.0, "pixel_pitch_um": 3.45}
    records.execute(sa.update(Session).where(Session.id == session).values(lens=lens))


def _reading(records: Any, session: str, _first: str) -> None:
    records.add(
        MeasuredPose(
            id=new_id("mps"),
            session_id=session,
            pose_id="P1",
            cycle=1,
            position_mm=[0.0, 0.0, 0.0],
            content_sha256="0" * 64,
        )
    )


def _content(records: Any, _session: str, first: str) -> None:
    """One bit of one stored point, and the same number of bytes."""
    points, markers = records.execute(
        sa.select(Result.points, Result.markers).where(Result.measurement_id == first)
    ).one()
    changed = bytes([*points[:-9], points[-9] ^ 1, *points[-8:]])
    assert len(changed) == len(points)
    records.execute(
        sa.update(Result)
        .where(Result.measurement_id == first)
        .values(points=changed, content_sha256=content_hash(changed, markers))
    )


def _field(**fields: Any) -> Callable[[Any, str, str], None]:
    def change(records: Any, _session: str, first: str) -> None:
        records.execute(sa.update(Measurement).where(Measurement.id == first).values(**fields))

    return change


def _target(records: Any, session: str, _first: str) -> None:
    used = sa.select(SessionTarget.target_id).where(SessionTarget.session_id == session)
    records.execute(sa.update(Target).where(Target.id.in_(used)).values(pitch_mm=25.1))


@pytest.mark.parametrize(
    "change",
    [
        _content,
        _field(cycle=7),
        _field(focus_group="x"),
        _field(joint_angles_deg=[1.0]),
        _field(pose_id="P2"),
        _field(excluded={"reason": "x", "by": None, "at": "2026-01-31T12:00:00+00:00"}),
        _target,
        _status("queued", finished_at=None),
        _status("failed", failure_code="not_converged"),
        _status("succeeded", attempts=2),
        _finished_again,
        _pose,
        _lens,
        _reading,
    ],
)
def test_every_change_changes_it(api: Any, store: Store, change: Callable[[Any, str, str], None]) -> None:
    session, other = new_session(api), new_session(api)
    first, *_ = store(api, session, shoot(cycles=1))
    before, elsewhere = mark(api, session), mark(api, other)
    assert mark(api, session) == before
    with api.installation.database.write() as records:
        change(records, session, first)
    assert mark(api, session) != before
    assert mark(api, other) == elsewhere != before


def test_the_hash_of_the_inputs_is_over_the_bytes_of_the_points(api: Any, store: Store) -> None:
    """As many points of the same image, measured elsewhere by a bit, are another input."""
    shots = shoot(cycles=2)
    session, same = new_session(api), new_session(api)
    first, *_ = store(api, session, shots)
    store(api, same, list(reversed(shots)))

    def asked(of: str) -> tuple[str, str]:
        answer = api.client.get(f"/v1/sessions/{of}/repeatability")
        assert answer.status_code == 200, answer.text
        return answer.json()["inputs_sha256"], answer.headers["ETag"]

    before = asked(session)
    assert asked(same)[0] == before[0]
    with api.installation.database.write() as records:
        _content(records, session, first)
    changed, tag = asked(session)
    assert changed != before[0]
    assert tag != before[1]
    stale = api.client.get(f"/v1/sessions/{session}/repeatability", headers={"If-None-Match": before[1]})
    assert stale.status_code == 200


def test_new_images_and_waiting_ones_change_it(api: Any, store: Store) -> None:
    session = new_session(api)
    marks = [mark(api, session)]
    for shots in (shoot(seed=1, cycles=1), with_fields(shoot(seed=2, cycles=1), status="queued")):
        store(api, session, shots)
        marks.append(mark(api, session))
    assert len(set(marks)) == 3


def answered(api: Any, store: Store) -> tuple[str, str, Any]:
    """Return a session, the address of its table of repeatability, and the first answer from there."""
    session = new_session(api)
    store(api, session, shoot(cycles=2))
    url = f"/v1/sessions/{session}/repeatability"
    return session, url, api.client.get(url)


def test_an_unchanged_session_is_neither_read_nor_computed_again(
    api: Any, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, url, first = answered(api, store)
    with monkeypatch.context() as broken:
        broken.delattr("app.analyses.service.compute")
        broken.delattr("app.analyses.service.read_snapshot")
        assert api.client.get(url).content == first.content
        again = api.client.get(url, headers={"If-None-Match": first.headers["ETag"]})
    assert (again.status_code, again.headers["ETag"]) == (304, first.headers["ETag"])
    # A process that was never asked knows the tag from the inputs alone, and computes nothing.
    with monkeypatch.context() as broken:
        broken.delattr("app.analyses.service.compute")
        broken.setattr(api.service.analyses, "_kept", AnswerCache())
        again = api.client.get(url, headers={"If-None-Match": first.headers["ETag"]})
    assert again.status_code == 304


def test_a_database_that_nobody_wrote_to_is_not_asked_for_the_mark(
    api: Any, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    session, url, first = answered(api, store)  # the first question writes the answer itself
    assert api.client.get(url).content == first.content
    with monkeypatch.context() as broken:
        broken.delattr("app.analyses.service.read_change_token")
        assert api.client.get(url).content == first.content
        assert api.client.get(url, headers={"If-None-Match": first.headers["ETag"]}).status_code == 304
    store(api, session, shoot(seed=2, cycles=2))
    assert api.client.get(url).headers["ETag"] != first.headers["ETag"]
    assert api.client.delete(f"/v1/sessions/{session}").status_code == 204
    assert api.client.get(url).status_code == 404


def test_every_commit_gives_the_database_another_version(api: Any) -> None:
    database = api.installation.database
    other = Database(database.url)

    names = (f"name {n}" for n in count())

    def renamed(rows: Any) -> None:
        rows.all(Statement(sa.update(Target).values(name=sa.bindparam("new"))), new=next(names))

    def by_orm(at: Database) -> None:
        with at.write() as records:
            records.execute(sa.update(Target).values(name=next(names)))

    def by_rows(at: Database) -> None:
        with at.write_rows(durable=False) as rows:
            renamed(rows)

    api.make_session()
    seen = [database.data_version()]
    for at in (database, other):
        for write in (by_orm, by_rows, lambda one: one.write_together(renamed)):
            write(at)
            seen.append(database.data_version())
    other.dispose()
    with database.read() as records:
        records.scalars(sa.select(Target.name)).all()
    assert None not in seen
    assert len(set(seen)) == len(seen)
    assert database.data_version() == seen[-1], "reading changes nothing"
