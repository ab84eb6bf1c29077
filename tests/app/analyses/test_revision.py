"""The session's mark: it changes with every change that an analysis can see, and saves the analysis where none was."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

import pytest
import sqlalchemy as sa

from app.records.ids import new_id
from app.records.tables import MeasuredPose, Measurement, Pose, Session
from app.services.analyses.revision import read_mark
from tests.app.analyses.conftest import Store, new_session, shoot, with_fields


def mark(api: Any, session: str) -> str:
    with api.installation.database.read() as records:
        return read_mark(records, session)


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
    before = read_mark(records, session)
    records.execute(sa.update(Pose).where(Pose.session_id == session).values(roll_deg=0.1 + 2.0**-56))
    assert read_mark(records, session) != before


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


@pytest.mark.parametrize(
    "change",
    [
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


def test_new_images_and_waiting_ones_change_it(api: Any, store: Store) -> None:
    session = new_session(api)
    marks = [mark(api, session)]
    for shots in (shoot(seed=1, cycles=1), with_fields(shoot(seed=2, cycles=1), status="queued")):
        store(api, session, shots)
        marks.append(mark(api, session))
    assert len(set(marks)) == 3


def test_an_unchanged_session_is_neither_read_nor_computed_again(
    api: Any, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = new_session(api)
    store(api, session, shoot(cycles=2))
    url = f"/v1/sessions/{session}/repeatability"
    first = api.client.get(url)
    with monkeypatch.context() as broken:
        broken.delattr("app.services.analyses.desk.compute")
        broken.delattr("app.services.analyses.desk.read_snapshot")
        assert api.client.get(url).content == first.content
        again = api.client.get(url, headers={"If-None-Match": first.headers["ETag"]})
    assert (again.status_code, again.headers["ETag"]) == (304, first.headers["ETag"])
    # A process that was never asked knows the tag from the inputs alone, and computes nothing.
    with monkeypatch.context() as broken:
        broken.delattr("app.services.analyses.desk.compute")
        broken.setattr(api.service.analyses, "_tags", type(api.service.analyses._tags)())
        again = api.client.get(url, headers={"If-None-Match": first.headers["ETag"]})
    assert again.status_code == 304
