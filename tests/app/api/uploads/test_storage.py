"""What uploads leave on the disk: nothing where they are refused or fail, and what a full disk refuses."""

from __future__ import annotations

import errno
import hashlib
import io
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from app.blobs.local import LocalBlobs, StagedBlob, map_storage_errors
from app.errors import StorageFull, Unavailable
from tests.support.service.service import OCTETS, image_address
from tests.support.service.stored_files import bomb, files_of


def test_a_full_disk_refuses_uploads_and_nothing_else(
    open_api: Any, grey_png: bytes, board_png: bytes
) -> None:
    with open_api() as running:
        session_id = running.make_session()
        kept = running.put_image(session_id, grey_png).json()
        data_dir = running.installation.settings.data_dir
    with open_api(data_dir, disk_floor_bytes=2**62) as running:
        for response in (
            running.put_image(session_id, board_png),
            running.client.post(
                f"/v1/sessions/{session_id}/images",
                files={"image": ("x.png", board_png)},
                data={"pose_id": "P1"},
            ),
        ):
            assert (response.status_code, response.json()["code"]) == (507, "storage_full")
        assert running.client.get(f"/v1/measurements/{kept['id']}/image").content == grey_png
        ready = running.client.get("/readyz")
        assert ready.status_code == 503
        assert [error["field"] for error in ready.json()["errors"]] == ["disk"]


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG])
def test_a_failed_write_is_storage_full_and_passes(
    api: Any, grey_png: bytes, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    """The disk itself says no: the system's call is replaced, none of our own code is."""
    session_id = api.make_session()

    def refuse(_descriptor: int) -> None:
        raise OSError(code, os.strerror(code))

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", refuse)
        response = api.put_image(session_id, grey_png)
        assert (response.status_code, response.json()["code"]) == (507, "storage_full")
    assert files_of(api) == []
    assert api.client.get(f"/v1/sessions/{session_id}").json()["counts"]["queued"] == 0
    assert api.put_image(session_id, grey_png).status_code == 202


def test_a_session_deleted_meanwhile_leaves_no_original(api: Any, grey_png: bytes) -> None:
    """The file is in place when its row turns out to have no session."""
    session_id = api.make_session()
    blobs: LocalBlobs = api.installation.blobs
    publish = blobs.publish

    def publish_then_lose_the_session(staged: StagedBlob) -> None:
        publish(staged)
        assert api.client.delete(f"/v1/sessions/{session_id}").status_code == 204

    blobs.publish = publish_then_lose_the_session  # type: ignore[method-assign]
    assert api.put_image(session_id, grey_png).status_code == 404
    assert files_of(api) == []


def test_interrupted_uploads_are_cleared_at_start(open_api: Any, tmp_path: Path) -> None:
    incoming = tmp_path / "data" / "originals" / "incoming"
    incoming.mkdir(parents=True)
    (incoming / "half").write_bytes(b"half an image")
    with open_api(tmp_path / "data") as running:
        assert files_of(running) == []


def test_room_is_judged_by_what_is_announced(tmp_path: Path) -> None:
    blobs = LocalBlobs(tmp_path)
    free = blobs.free_bytes()
    blobs.check_room(0, 1)
    with pytest.raises(StorageFull):
        blobs.check_room(0, 2 * free)


def test_an_original_lost_from_the_disk_is_missing_and_comes_back_with_the_next_upload(
    api: Any, grey_png: bytes
) -> None:
    session_id = api.make_session()
    first = api.put_image(session_id, grey_png).json()
    question = {"images": [{"pose_id": "P1", "sha256": first["sha256"]}]}
    missing = f"/v1/sessions/{session_id}/images/missing"
    expected = [{**question["images"][0], "target_id": None}]
    assert api.client.post(missing, json=question).json() == {"missing": []}
    (original,) = files_of(api)
    for damage in (original.unlink, lambda: os.truncate(original, 10)):
        damage()
        assert api.client.post(missing, json=question).json()["missing"] == expected
        again = api.put_image(session_id, grey_png)
        assert (again.status_code, again.json()["id"]) == (200, first["id"])
        assert original.read_bytes() == grey_png
        assert api.client.get(f"/v1/measurements/{first['id']}/image").content == grey_png
        assert files_of(api) == [original]


def test_a_folder_that_cannot_be_written_is_no_defect(api: Any, grey_png: bytes) -> None:
    session_id = api.make_session()
    folder = api.installation.blobs.path(hashlib.sha256(grey_png).hexdigest()).parent
    folder.write_text("in the way")
    refused = api.put_image(session_id, grey_png)
    assert (refused.status_code, refused.json()["code"]) == (503, "storage_unavailable")
    folder.unlink()
    assert api.put_image(session_id, grey_png).status_code == 202


def test_too_many_open_files_are_not_called_a_full_disk() -> None:
    with pytest.raises(Unavailable), map_storage_errors():
        raise OSError(errno.EMFILE, "Too many open files")


def _hash_of_others(api: Any, session_id: str, data: bytes) -> Any:
    return api.client.put(image_address(session_id, data + b"x"), content=data, headers=OCTETS)


def _in_a_form(api: Any, session_id: str, data: bytes, **fields: str) -> Any:
    address = f"/v1/sessions/{session_id}/images"
    return api.client.post(address, files={"image": ("x.png", data)}, data={"pose_id": "P1", **fields})


def _in_a_broken_form(api: Any, session_id: str, data: bytes) -> Any:
    body = b'--B\r\nContent-Disposition: form-data; name="image"; filename="x.png"\r\n\r\n' + data
    headers = {"Content-Type": "multipart/form-data; boundary=B"}
    return api.client.post(f"/v1/sessions/{session_id}/images", content=body, headers=headers)


REFUSED: dict[str, Callable[[Any, str, bytes], Any]] = {
    "another hash": _hash_of_others,
    "empty": lambda api, session_id, _: api.put_image(session_id, b""),
    "another format": lambda api, session_id, _: api.put_image(session_id, b"GIF89a" + bytes(100)),
    "damaged header": lambda api, session_id, data: api.put_image(session_id, data[:20]),
    "too many pixels": lambda api, session_id, _: api.put_image(session_id, bomb(60_000, 60_000)),
    "too large": lambda api, session_id, data: api.put_image(session_id, data + bytes(200_000)),
    "another target": lambda api, session_id, data: api.put_image(session_id, data, target_id="tgt_none"),
    "another session": lambda api, _, data: api.put_image("ses_none", data),
    "wrong metadata": lambda api, session_id, data: api.put_image(session_id, data, cycle="0"),
    "form: wrong metadata": lambda api, session_id, data: _in_a_form(api, session_id, data, cycle="0"),
    "form: another target": lambda api, session_id, data: _in_a_form(api, session_id, data, target_id="t"),
    "form: another format": lambda api, session_id, _: _in_a_form(api, session_id, b"GIF89a" + bytes(100)),
    "form: too large": lambda api, session_id, data: _in_a_form(api, session_id, data + bytes(200_000)),
    "form: broken": _in_a_broken_form,
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_refused_upload_leaves_no_file(open_api: Any, grey_png: bytes, name: str) -> None:
    with open_api(max_upload_bytes=100_000) as running:
        response = REFUSED[name](running, running.make_session(), grey_png)
        assert 400 <= response.status_code < 500
        assert response.json()["code"]
        assert files_of(running) == []


@pytest.mark.parametrize("code", [errno.EFBIG, errno.EIO, errno.EACCES, errno.EROFS, errno.EMFILE])
@pytest.mark.parametrize(
    ("call", "nth"), [("write", 1), ("fsync", 1), ("fsync", 2), ("replace", 1), ("open folder", 1)]
)
def test_an_upload_that_fails_at_any_step_leaves_no_file(
    api: Any, grey_png: bytes, monkeypatch: pytest.MonkeyPatch, call: str, nth: int, code: int
) -> None:
    """The system's calls are replaced, none of our own code is. The second fsync is that of the folder: the file is in
    place by then."""
    session_id = api.make_session()
    calls = 0

    def failing(original: Callable[..., Any]) -> Callable[..., Any]:
        def refuse(*arguments: Any, **options: Any) -> Any:
            nonlocal calls
            calls += 1
            if calls == nth:
                raise OSError(code, os.strerror(code))
            return original(*arguments, **options)

        return refuse

    name = {"open folder": "open"}.get(call, call)
    with monkeypatch.context() as patched:
        if call == "write":

            class Full(io.FileIO):
                write = failing(io.FileIO.write)

            patched.setattr("app.blobs.local.FileIO", Full)
        else:
            patched.setattr(os, name, failing(getattr(os, name)))
        response = api.put_image(session_id, grey_png)
    assert calls >= nth
    answers = {errno.EMFILE: (503, "busy"), errno.EFBIG: (507, "storage_full")}
    assert (response.status_code, response.json()["code"]) == answers.get(code, (503, "storage_unavailable"))
    assert files_of(api) == []
    assert api.client.get(f"/v1/sessions/{session_id}").json()["counts"]["queued"] == 0
    assert api.put_image(session_id, grey_png).status_code == 202


def test_a_full_database_refuses_an_upload_and_leaves_no_file(api: Any, grey_png: bytes) -> None:
    session_id = api.make_session()
    with api.installation.database.engine.connect() as connection:
        pages = connection.exec_driver_sql("PRAGMA page_count").scalar()
        connection.exec_driver_sql(f"PRAGMA max_page_count={pages}")
    refused = None
    for number in range(2000):
        data = grey_png + number.to_bytes(4, "big")
        before = files_of(api)
        refused = api.put_image(session_id, data, filename="x" * 255)
        if refused.status_code != 202:
            break
    assert refused is not None
    assert (refused.status_code, refused.json()["code"]) == (507, "storage_full")
    assert files_of(api) == before
