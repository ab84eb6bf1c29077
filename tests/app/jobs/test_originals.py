"""Only the bytes that were uploaded are measured, drawn and delivered; what the disk lost comes back by an upload."""

from __future__ import annotations

import errno
import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from app.blobs.integrity import PIECE, open_original, read_original
from app.errors import OriginalCorrupt, OriginalMissing, StorageUnusable, Unavailable
from app.jobs.painting.worker import paint_thumbnail
from app.jobs.process_image import process_image
from app.jobs.queue import JobResult
from app.services.measurements.retries import queue_restored
from tests.support.image.images import encode, flip_bit
from tests.support.jobs.runners import compute


def cut(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def stored(api: Any, measurement: dict[str, Any]) -> Path:
    path: Path = api.installation.blobs.path(measurement["sha256"])
    return path


def missing(api: Any, measurement: dict[str, Any]) -> list[Any]:
    answer = api.client.post(
        f"/v1/sessions/{measurement['session_id']}/images/missing",
        json={"images": [{"pose_id": measurement["pose_id"], "sha256": measurement["sha256"]}]},
    )
    found: list[Any] = answer.json()["missing"]
    return found


@pytest.fixture(scope="module")
def board_bmp(board_png: bytes) -> bytes:
    """A photograph of the target in a format without checksums: with a changed bit it decodes as well as without."""
    return encode(".bmp", cv2.imdecode(np.frombuffer(board_png, np.uint8), cv2.IMREAD_UNCHANGED))


@pytest.mark.parametrize(
    ("damage", "code"),
    [(flip_bit, "original_corrupt"), (cut, "original_corrupt"), (Path.unlink, "original_missing")],
)
def test_a_damaged_original_is_not_measured_and_an_upload_mends_it(
    api: Any, board_bmp: bytes, damage: Callable[[Path], None], code: str
) -> None:
    """A changed bit used to be measured as if nothing were amiss, under the hash of the image that was uploaded."""
    session_id, elsewhere = api.make_session(), api.make_session()
    first = api.put_image(session_id, board_bmp).json()
    other = api.put_image(elsewhere, board_bmp, "P7").json()
    damage(stored(api, first))
    assert {item.outcome.failure.code for item in compute(api) if item.outcome.failure} == {code}
    failed = api.client.get(f"/v1/measurements/{first['id']}").json()
    assert (failed["status"], failed["failure"]["code"]) == ("failed", code)
    assert failed["failure"]["advice"]
    assert len(missing(api, first)) == len(missing(api, other)) == 1

    again = api.put_image(session_id, board_bmp)
    assert (again.status_code, again.json()["id"]) == (200, first["id"])
    assert (again.json()["status"], again.json()["failure"]) == ("queued", None)
    assert stored(api, first).read_bytes() == board_bmp
    compute(api)
    for measurement in (first, other):
        document = api.client.get(f"/v1/measurements/{measurement['id']}").json()
        assert (document["status"], document["failure"]) == ("succeeded", None)
        assert missing(api, measurement) == []


def test_the_same_image_for_another_session_mends_it_too(any_api: Any, grey_png: bytes) -> None:
    first = any_api.put_image(any_api.make_session(), grey_png).json()
    flip_bit(stored(any_api, first))
    compute(any_api)
    assert any_api.put_image(any_api.make_session(), grey_png).status_code == 202
    document = any_api.client.get(f"/v1/measurements/{first['id']}").json()
    assert (document["status"], document["failure"]) == ("queued", None)


@pytest.mark.parametrize("elsewhere", [False, True])
@pytest.mark.parametrize("damage", [flip_bit, Path.unlink])
def test_an_original_that_comes_back_while_its_job_runs_is_measured(
    any_api: Any, grey_png: bytes, elsewhere: bool, damage: Callable[[Path], None]
) -> None:
    """The job read it before and failed after: nothing queued it again, although the file was there."""
    api, queue, blobs = any_api, any_api.installation.queue, any_api.installation.blobs
    session_id = api.make_session()
    first = api.put_image(session_id, grey_png).json()
    (job,) = queue.claim(10)
    damage(stored(api, first))
    failed = JobResult(job, *process_image(job, str(blobs.path(job.sha256)), 10**7))
    again = api.put_image(api.make_session() if elsewhere else session_id, grey_png)
    assert (again.status_code, again.json()["status"]) == (202 if elsewhere else 200, "queued")
    assert queue.finish([failed]) == 0
    document = api.client.get(f"/v1/measurements/{first['id']}").json()
    assert (document["status"], document["failure"]) == ("queued", None)
    compute(api)
    measured = api.client.get(f"/v1/measurements/{first['id']}").json()
    assert measured["failure"]["code"] == "target_not_found"


def test_a_whole_original_that_is_sent_again_leaves_its_job_alone(any_api: Any, grey_png: bytes) -> None:
    api, queue = any_api, any_api.installation.queue
    session_id = api.make_session()
    first = api.put_image(session_id, grey_png).json()
    (job,) = queue.claim(10)
    assert api.put_image(session_id, grey_png).json()["status"] == "running"
    assert api.put_image(api.make_session(), grey_png).json()["status"] == "queued"
    document = api.client.get(f"/v1/measurements/{first['id']}").json()
    assert document["status"] == "running"
    assert queue.finish([JobResult(job, *process_image(job, str(stored(api, first)), 10**7))]) == 1


def test_only_rows_that_may_lack_their_original_are_read(
    any_api: Any, grey_png: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every upload used to read all finished measurements of the same bytes."""
    first = any_api.put_image(any_api.make_session(), grey_png).json()
    compute(any_api)
    read: list[str] = []

    def note(codes: str | None, _retry: Any) -> bool:
        read.append(str(codes))
        return False

    with monkeypatch.context() as patched:
        patched.setattr("app.services.measurements.retries.lacked_original", note)
        assert queue_restored(any_api.installation, first["sha256"], replaced=True) == 0
    assert read == []


def test_a_retry_of_a_damaged_original_keeps_the_good_result(any_api: Any, board_png: bytes) -> None:
    session_id = any_api.make_session()
    first = any_api.put_image(session_id, board_png).json()
    compute(any_api)
    good = any_api.client.get(f"/v1/measurements/{first['id']}").json()
    assert good["status"] == "succeeded"
    flip_bit(stored(any_api, first))
    assert any_api.client.post(f"/v1/measurements/{first['id']}/retry").status_code == 202
    compute(any_api)
    kept = any_api.client.get(f"/v1/measurements/{first['id']}").json()
    assert kept["retry_failure"]["code"] == "original_corrupt"
    assert {**kept, "retry_failure": None} == good
    # The retry that was asked for is made once the image is there again.
    assert len(missing(any_api, first)) == 1
    assert any_api.put_image(session_id, board_png).json()["status"] == "queued"
    compute(any_api)
    again = any_api.client.get(f"/v1/measurements/{first['id']}").json()
    assert (again["status"], again["retry_failure"]) == ("succeeded", None)
    assert again["calibration"] == good["calibration"]
    assert again["finished_at"] > good["finished_at"]


@pytest.mark.slow
@pytest.mark.parametrize("damage", [flip_bit, cut])
def test_a_damaged_original_is_not_delivered(
    api: Any, board_png: bytes, damage: Callable[[Path], None]
) -> None:
    session_id = api.make_session()
    first = api.put_image(session_id, board_png).json()
    compute(api)
    image = api.client.get(f"/v1/measurements/{first['id']}/image")
    assert (image.content, image.headers["content-length"]) == (board_png, str(len(board_png)))
    damage(stored(api, first))
    for form in ("image", "overlay", "thumbnail"):
        refused = api.client.get(f"/v1/measurements/{first['id']}/{form}")
        assert (refused.status_code, refused.json()["code"]) == (409, "original_corrupt")
        assert refused.json()["advice"]
    assert api.put_image(session_id, board_png).status_code == 200
    mended = api.client.get(f"/v1/measurements/{first['id']}/image")
    assert (mended.status_code, mended.content) == (200, board_png)
    stored(api, first).unlink()
    for form in ("image", "overlay", "thumbnail"):
        gone = api.client.get(f"/v1/measurements/{first['id']}/{form}")
        assert (gone.status_code, gone.json()["code"]) == (404, "original_missing")


def test_what_was_looked_at_is_what_is_sent(tmp_path: Path) -> None:
    """A file of several pieces that is replaced and deleted between its check and its delivery."""
    data = os.urandom(2 * PIECE + 17)
    path, sha256 = tmp_path / "original", hashlib.sha256(data).hexdigest()
    path.write_bytes(data)
    with open_original(path, sha256, len(data)) as file:
        (tmp_path / "other").write_bytes(b"other")
        (tmp_path / "other").replace(path)
        path.unlink()
        assert file.read() == data
    with pytest.raises(OriginalMissing):
        open_original(path, sha256, len(data))


def test_what_the_disk_cannot_read_is_corrupt_and_a_lack_of_files_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The system's call is replaced, none of our own code is."""
    path, sha256 = tmp_path / "original", hashlib.sha256(b"x").hexdigest()
    path.write_bytes(b"x")
    for code, kind in (
        (errno.EIO, OriginalCorrupt),
        (errno.EMFILE, Unavailable),
        (errno.EACCES, StorageUnusable),
        (errno.EROFS, StorageUnusable),
    ):

        def refuse(*_arguments: Any, _code: int = code, **_options: Any) -> Any:
            raise OSError(_code, os.strerror(_code))

        with monkeypatch.context() as patched:
            patched.setattr("io.open", refuse)
            with pytest.raises(kind):
                read_original(path, sha256)
            with pytest.raises(kind):
                open_original(path, sha256, 1)
    (tmp_path / "folder").mkdir()
    with pytest.raises(OriginalCorrupt):
        read_original(tmp_path / "folder", sha256)
    drawn = paint_thumbnail(str(path), "0" * 64, 10**7)
    assert isinstance(drawn, OriginalCorrupt)


def test_a_whole_original_is_not_written_again(api: Any, grey_png: bytes) -> None:
    session_id = api.make_session()
    first = api.put_image(session_id, grey_png).json()
    before = stored(api, first).stat()
    assert api.put_image(session_id, grey_png).status_code == 200
    after = stored(api, first).stat()
    assert (after.st_ino, after.st_mtime_ns) == (before.st_ino, before.st_mtime_ns)


def test_a_file_that_cannot_be_replaced_for_being_open_is_good_if_it_is_whole(
    api: Any, grey_png: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As Windows refuses it; the system's call is replaced, none of our own code is."""
    first = api.put_image(api.make_session(), grey_png).json()

    def refuse(*_arguments: Any, **_options: Any) -> None:
        raise PermissionError(errno.EACCES, "the file is open")

    elsewhere = api.make_session()
    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", refuse)
        assert api.put_image(elsewhere, grey_png).status_code == 202
        flip_bit(stored(api, first))
        refused = api.put_image(api.make_session(), grey_png)
        assert (refused.status_code, refused.json()["code"]) == (503, "storage_unavailable")
    assert [path.name for path in stored(api, first).parent.parent.joinpath("incoming").iterdir()] == []
