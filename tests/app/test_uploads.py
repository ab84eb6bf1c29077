"""Images in: both ways, their refusals, and what is left on the disk."""

from __future__ import annotations

import errno
import hashlib
import os
import struct
import threading
import zlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.blobs.local import LocalBlobs, StagedBlob, storage_refusals
from app.errors import StorageFull, Unavailable

OCTETS = {"Content-Type": "application/octet-stream"}


def files_of(api: Any) -> list[Path]:
    """Everything in the blob store but folders."""
    return [path for path in api.installation.blobs.root.rglob("*") if path.is_file()]


def image_address(session_id: str, data: bytes, pose_id: str = "P1") -> str:
    return f"/v1/sessions/{session_id}/poses/{pose_id}/images/{hashlib.sha256(data).hexdigest()}"


def bomb(width: int, height: int) -> bytes:
    """A PNG whose header states far more pixels than its bytes hold."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    pixels = zlib.compress(b"\0" * 1000)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


def test_a_raw_upload_is_kept_with_its_metadata(any_api: Any, grey_png: bytes) -> None:
    session_id = any_api.make_session()
    response = any_api.put_image(
        session_id,
        grey_png,
        cycle=3,
        focus_group="near",
        joint_angles_deg="1, -2.5,3e1",
        captured_at="2026-01-31T12:00:00.5+02:00",
        filename="C:\\photos\\a\x01\u202e b.png",
    )
    assert response.status_code == 202, response.text
    document = response.json()
    assert response.headers["location"] == f"/v1/measurements/{document['id']}"
    expected = {
        "session_id": session_id,
        "pose_id": "P1",
        "cycle": 3,
        "focus_group": "near",
        "joint_angles_deg": [1.0, -2.5, 30.0],
        "captured_at": "2026-01-31T10:00:00.500000Z",
        "filename": "a b.png",
        "sha256": hashlib.sha256(grey_png).hexdigest(),
        "bytes": len(grey_png),
        "status": "queued",
        "attempts": 0,
        "siblings": [],
        "finished_at": None,
        "duration_ms": None,
        "failure": None,
        "calibration": None,
        "points": None,
    }
    assert {key: document[key] for key in expected} == expected
    assert any_api.client.get(response.headers["location"]).json() == document
    assert any_api.client.get(f"/v1/sessions/{session_id}").json()["counts"]["queued"] == 1
    pose = any_api.client.get(f"/v1/sessions/{session_id}/poses/P1").json()
    assert pose.pop("pose_id") == "P1"
    assert set(pose.values()) == {None}


def test_the_original_comes_back_as_an_attachment(api: Any, grey_png: bytes) -> None:
    measurement = api.put_image(api.make_session(), grey_png, filename='../../é"x.png').json()
    image = api.client.get(f"/v1/measurements/{measurement['id']}/image")
    assert image.content == grey_png
    assert image.headers["content-type"] == "image/png"
    assert image.headers["x-content-type-options"] == "nosniff"
    assert image.headers["content-disposition"].startswith("attachment; ")
    assert "/" not in measurement["filename"]


@pytest.mark.parametrize(
    "requested", ["bytes=0-3", "bytes=abc", "bytes=999999999-", "lines=1-2", "bytes=5-1"]
)
def test_an_original_is_always_whole(api: Any, grey_png: bytes, requested: str) -> None:
    measurement = api.put_image(api.make_session(), grey_png).json()
    image = api.client.get(f"/v1/measurements/{measurement['id']}/image", headers={"Range": requested})
    assert (image.status_code, image.content) == (200, grey_png)
    assert image.headers["accept-ranges"] == "none"


def test_the_same_upload_again_gives_the_first_measurement(any_api: Any, grey_png: bytes) -> None:
    session_id = any_api.make_session()
    first = any_api.put_image(session_id, grey_png, cycle=1)
    again = any_api.put_image(session_id, grey_png, cycle=2, focus_group="far")
    upper = any_api.client.put(
        f"/v1/sessions/{session_id}/poses/P1/images/{first.json()['sha256'].upper()}",
        content=grey_png,
        headers=OCTETS,
    )
    form = any_api.client.post(
        f"/v1/sessions/{session_id}/images", files={"image": ("x.png", grey_png)}, data={"pose_id": "P1"}
    )
    assert [r.status_code for r in (first, again, upper, form)] == [202, 200, 200, 200]
    assert again.json() == upper.json() == form.json() == first.json()
    assert again.headers["location"] == first.headers["location"]
    elsewhere = any_api.put_image(session_id, grey_png, "P2")
    assert elsewhere.status_code == 202
    assert elsewhere.json()["id"] != first.json()["id"]
    assert len(files_of(any_api)) == 1


def test_simultaneous_uploads_of_one_image_make_one_measurement(any_api: Any, grey_png: bytes) -> None:
    session_id = any_api.make_session()
    start = threading.Barrier(6)

    def send(_number: int) -> Any:
        start.wait()
        return any_api.put_image(session_id, grey_png)

    with ThreadPoolExecutor(6) as pool:
        responses = list(pool.map(send, range(6)))
    assert sorted(r.status_code for r in responses) == [200] * 5 + [202]
    assert len({r.json()["id"] for r in responses}) == 1


def test_a_form_upload_is_kept_with_its_metadata(api: Any, grey_png: bytes) -> None:
    session_id = api.make_session()
    response = api.client.post(
        f"/v1/sessions/{session_id}/images",
        files={"image": ("../x/photo 1.png", grey_png, "image/png")},
        data={
            "pose_id": "P7",
            "cycle": "2",
            "captured_at": "2026-01-31T12:00:00Z",
            "joint_angles_deg": "1,2",
        },
    )
    assert response.status_code == 202, response.text
    document = response.json()
    assert (document["pose_id"], document["cycle"], document["filename"]) == ("P7", 2, "photo 1.png")
    assert document["joint_angles_deg"] == [1.0, 2.0]
    assert api.client.get(f"/v1/measurements/{document['id']}/image").content == grey_png


@pytest.mark.parametrize(
    ("data", "files", "field"),
    [
        ({}, {"image": b"x"}, "pose_id"),
        ({"pose_id": "a b"}, {"image": b"x"}, "pose_id"),
        ({"pose_id": "P1", "cycle": "0"}, {"image": b"x"}, "cycle"),
        ({"pose_id": "P1", "cycle": "1.5"}, {"image": b"x"}, "cycle"),
        ({"pose_id": "P1", "colour": "red"}, {"image": b"x"}, "colour"),
        ({"pose_id": "P1", "focus_group": "a\x00"}, {"image": b"x"}, "focus_group"),
        ({"pose_id": "P1", "captured_at": "yesterday"}, {"image": b"x"}, "captured_at"),
        ({"pose_id": "P1", "joint_angles_deg": "1,nan"}, {"image": b"x"}, "joint_angles_deg"),
        ({"pose_id": "P1"}, {"picture": b"x"}, "picture"),
    ],
)
def test_a_wrong_form_is_refused(
    api: Any, grey_png: bytes, data: dict[str, str], files: dict[str, bytes], field: str
) -> None:
    address = f"/v1/sessions/{api.make_session()}/images"
    response = api.client.post(address, data=data, files=dict.fromkeys(files, ("x.png", grey_png)))
    assert response.status_code == 422, response.text
    assert field in [error["field"] for error in response.json()["errors"]]
    assert files_of(api) == []


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"--B\r\n",
        b"no boundary at all",
        b'--B\r\nContent-Disposition: form-data; name="image"; filename="x"\r\n\r\nabc',
        b'--B\r\nContent-Disposition: form-data; name="pose_id"\r\n\r\nP1\r\n--B--\r\n',
        b"--B\r\nContent-Disposition: form-data\r\n\r\nabc\r\n--B--\r\n",
        b'--B\r\nContent-Disposition: form-data; name="pose_id"\r\n\r\n\xff\r\n--B--\r\n',
        b'--B\r\nContent-Disposition: form-data; name="pose_id"\r\n\r\nP\r\n--B\r\n'
        b'Content-Disposition: form-data; name="pose_id"\r\n\r\nP\r\n--B--\r\n',
        b"--B\r\nX-Long: " + b"a" * 100_000 + b"\r\n\r\nabc\r\n--B--\r\n",
        b"".join(b'--B\r\nContent-Disposition: form-data; name="f%d"\r\n\r\nP\r\n' % n for n in range(50))
        + b"--B--\r\n",
    ],
)
def test_a_broken_form_is_refused(api: Any, body: bytes) -> None:
    response = api.client.post(
        f"/v1/sessions/{api.make_session()}/images",
        content=body,
        headers={"Content-Type": "multipart/form-data; boundary=B"},
    )
    assert response.status_code == 422, response.text
    assert files_of(api) == []


@pytest.mark.parametrize(
    "media_type", ["application/json", "multipart/form-data", "text/plain", "multipart/form-data; boundary="]
)
def test_a_form_of_another_media_type_is_refused(api: Any, media_type: str) -> None:
    address = f"/v1/sessions/{api.make_session()}/images"
    response = api.client.post(address, content=b"x", headers={"Content-Type": media_type})
    assert (response.status_code, response.json()["code"]) == (415, "unsupported_media_type")


@pytest.mark.parametrize("media_type", ["application/json", "text/plain", "multipart/form-data"])
def test_a_raw_upload_of_another_media_type_is_refused(api: Any, grey_png: bytes, media_type: str) -> None:
    address = image_address(api.make_session(), grey_png)
    response = api.client.put(address, content=grey_png, headers={"Content-Type": media_type})
    assert (response.status_code, response.json()["code"]) == (415, "unsupported_media_type")


@pytest.mark.parametrize(
    "query",
    [
        {"cycle": "0"},
        {"cycle": "-1"},
        {"cycle": "1.5"},
        {"cycle": "1e2"},
        {"cycle": "9" * 30},
        {"cycle": "2147483648"},
        {"focus_group": ""},
        {"focus_group": "a\x07"},
        {"focus_group": "x" * 201},
        {"joint_angles_deg": "1,,2"},
        {"joint_angles_deg": "inf"},
        {"joint_angles_deg": "1e999"},
        {"joint_angles_deg": ",".join(["1"] * 13)},
        {"captured_at": "2026-01-31"},
        {"captured_at": "2026-01-31T12:00:00"},
        {"captured_at": "2026-13-31T12:00:00Z"},
        {"captured_at": "0001-01-01T00:00:00+14:00"},
        {"captured_at": "9999-12-31T23:59:59-14:00"},
        {"captured_at": "1700000000"},
        {"target_id": "tgt_other"},
        {"target_id": "\x00"},
        {"filename": "x" * 1001},
    ],
)
def test_wrong_metadata_is_refused(any_api: Any, grey_png: bytes, query: dict[str, str]) -> None:
    session_id = any_api.make_session()
    response = any_api.put_image(session_id, grey_png, **query)
    assert response.status_code == 422, response.text
    assert response.json()["errors"][0]["field"] == next(iter(query))
    assert files_of(any_api) == []


@pytest.mark.parametrize("sha256", ["abc", "g" * 64, "0" * 63, "0" * 65, "0" * 64 + "%0A"])
def test_a_hash_that_is_none_is_refused(api: Any, sha256: str) -> None:
    address = f"/v1/sessions/{api.make_session()}/poses/P1/images/{sha256}"
    response = api.client.put(address, content=b"x", headers=OCTETS)
    assert (response.status_code, response.json()["code"]) == (422, "invalid_request")


def test_a_hash_mismatch_keeps_nothing(api: Any, grey_png: bytes) -> None:
    session_id = api.make_session()
    response = api.client.put(image_address(session_id, b"other"), content=grey_png, headers=OCTETS)
    assert (response.status_code, response.json()["code"]) == (422, "hash_mismatch")
    assert files_of(api) == []
    assert api.client.get(f"/v1/sessions/{session_id}/poses").json()["items"] == []


def test_an_empty_upload_is_said_to_be_empty_before_its_hash_is_wrong(api: Any) -> None:
    session_id = api.make_session()
    for address in (image_address(session_id, b""), image_address(session_id, b"other")):
        response = api.client.put(address, content=b"", headers=OCTETS)
        assert (response.status_code, response.json()["code"]) == (422, "empty_upload")
    form = api.client.post(
        f"/v1/sessions/{session_id}/images", files={"image": ("x.png", b"")}, data={"pose_id": "P1"}
    )
    assert (form.status_code, form.json()["code"]) == (422, "empty_upload")


@pytest.mark.parametrize(
    "data", [b"GIF89a" + b"\0" * 100, b"RIFF\0\0\0\0WEBPVP8 ", b"%PDF-1.7", b"\0" * 1000, b"hello", b"x"]
)
def test_another_format_is_refused(api: Any, data: bytes) -> None:
    response = api.put_image(api.make_session(), data)
    assert (response.status_code, response.json()["code"]) == (415, "unsupported_image")
    assert response.json()["advice"]
    assert files_of(api) == []


def test_a_bomb_is_refused_by_its_header(api: Any) -> None:
    response = api.put_image(api.make_session(), bomb(40_000, 40_000))
    assert (response.status_code, response.json()["code"]) == (422, "image_too_many_pixels")
    assert files_of(api) == []


def test_the_limit_of_pixels_is_the_setting(open_api: Any, grey_png: bytes) -> None:
    with open_api(max_image_pixels=64 * 48) as running:
        assert running.put_image(running.make_session(), grey_png).status_code == 202
    with open_api(max_image_pixels=64 * 48 - 1) as running:
        response = running.put_image(running.make_session(), grey_png)
        assert (response.status_code, response.json()["code"]) == (422, "image_too_many_pixels")


def test_a_file_cut_short_anywhere_is_refused_or_taken_never_a_defect(api: Any, grey_png: bytes) -> None:
    session_id = api.make_session()
    for length in range(1, len(grey_png)):
        response = api.put_image(session_id, grey_png[:length])
        assert response.status_code == 202 or response.json()["code"] in (
            "undecodable_image",
            "unsupported_image",
        )
    taken = api.client.get(f"/v1/sessions/{session_id}").json()["counts"]["queued"]
    assert len(files_of(api)) == taken


@pytest.mark.parametrize("extension", [".png", ".jpg", ".tiff", ".bmp"])
def test_every_format_is_taken(api: Any, picture: Callable[[str, Any], bytes], extension: str) -> None:
    session_id = api.make_session()
    for image in (np.zeros((20, 30), np.uint8), np.zeros((20, 30, 3), np.uint8)):
        assert api.put_image(session_id, picture(extension, image)).status_code == 202


@pytest.mark.parametrize("chunked", [False, True])
@pytest.mark.parametrize("form", [False, True])
def test_an_upload_over_the_limit_is_refused(
    open_api: Any, grey_png: bytes, chunked: bool, form: bool
) -> None:
    limit = 100_000
    padded = grey_png + b"\0" * (limit - len(grey_png))
    with open_api(max_upload_bytes=limit) as running:
        session_id = running.make_session()

        def send(data: bytes) -> Any:
            address, body, headers = image_address(session_id, data), data, OCTETS
            if form:
                head = b'--B\r\nContent-Disposition: form-data; name="pose_id"\r\n\r\nP1\r\n--B\r\n'
                head += b'Content-Disposition: form-data; name="image"; filename="x.png"\r\n\r\n'
                address, body = f"/v1/sessions/{session_id}/images", head + data + b"\r\n--B--\r\n"
                headers = {"Content-Type": "multipart/form-data; boundary=B"}
            pieces: Iterator[bytes] = (body[i : i + 4096] for i in range(0, len(body), 4096))
            if form:
                return running.client.post(address, content=pieces if chunked else body, headers=headers)
            return running.client.put(address, content=pieces if chunked else body, headers=headers)

        assert send(padded).status_code == 202
        for excess in (1, 10_000_000):
            response = send(padded + b"\0" * excess)
            assert (response.status_code, response.json()["code"]) == (413, "upload_too_large")
        assert len(files_of(running)) == 1


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


def test_an_image_that_names_no_target_is_one_measurement_until_it_is_searched(
    any_api: Any, grey_png: bytes
) -> None:
    first, second = any_api.make_target(), any_api.make_target(columns=7)
    session_id = any_api.make_session(first, second)
    seeking = any_api.put_image(session_id, grey_png)
    assert (seeking.status_code, seeking.json()["target_id"]) == (202, None)
    assert seeking.json()["siblings"] == []
    again = any_api.put_image(session_id, grey_png, cycle=5)
    form = any_api.client.post(
        f"/v1/sessions/{session_id}/images", files={"image": ("x.png", grey_png)}, data={"pose_id": "P1"}
    )
    assert [again.status_code, form.status_code] == [200, 200]
    assert again.json() == form.json() == seeking.json()
    named = [any_api.put_image(session_id, grey_png, target_id=target_id) for target_id in (first, second)]
    assert [response.status_code for response in named] == [202, 202]
    assert [response.json()["target_id"] for response in named] == [first, second]
    ids = [response.json()["id"] for response in (seeking, *named)]
    assert named[1].json()["siblings"] == ids[:2]
    listed = any_api.client.get(f"/v1/sessions/{session_id}/measurements").json()["items"]
    assert [item["id"] for item in listed] == ids
    assert [item["siblings"] for item in listed] == [ids[1:], [ids[0], ids[2]], ids[:2]]
    elsewhere = any_api.put_image(session_id, grey_png, "P2").json()
    assert elsewhere["siblings"] == []
    repeated = any_api.put_image(session_id, grey_png)
    assert (repeated.status_code, repeated.json()["siblings"]) == (200, ids[1:])
    wrong = any_api.put_image(session_id, grey_png, target_id=any_api.make_target())
    assert (wrong.status_code, wrong.json()["code"]) == (422, "target_unknown")


def test_simultaneous_uploads_without_target_make_one_measurement(any_api: Any, grey_png: bytes) -> None:
    session_id = any_api.make_session(any_api.make_target(), any_api.make_target(columns=7))
    start = threading.Barrier(6)

    def send(_number: int) -> Any:
        start.wait()
        return any_api.put_image(session_id, grey_png)

    with ThreadPoolExecutor(6) as pool:
        responses = list(pool.map(send, range(6)))
    assert sorted(r.status_code for r in responses) == [200] * 5 + [202]
    assert len({r.json()["id"] for r in responses}) == 1


def test_targets_that_come_and_go_leave_an_upload_the_same(any_api: Any, grey_png: bytes) -> None:
    """Without a target it was sent, and without a target it is found, however many the session has by then."""
    one, two = any_api.make_target(), any_api.make_target(columns=7)
    session_id = any_api.make_session(one)
    address = f"/v1/sessions/{session_id}"
    alone = any_api.put_image(session_id, grey_png).json()
    assert alone["target_id"] == one
    assert any_api.client.patch(address, json={"target_ids": [two, one]}).status_code == 200
    again = any_api.put_image(session_id, grey_png)
    assert (again.status_code, again.json()) == (200, alone)
    assert any_api.put_image(session_id, grey_png, target_id=one).json() == alone
    seeking = any_api.put_image(session_id, grey_png, "P2")
    assert (seeking.status_code, seeking.json()["target_id"]) == (202, None)
    # what is not found yet is no reason to keep a target
    assert any_api.client.patch(address, json={"target_ids": [one]}).status_code == 200
    again = any_api.put_image(session_id, grey_png, "P2")
    assert (again.status_code, again.json()) == (200, seeking.json())
    refused = any_api.client.patch(address, json={"target_ids": [two]})
    assert (refused.status_code, refused.json()["code"]) == (422, "target_in_use")


def test_missing_images_are_named(any_api: Any, grey_png: bytes) -> None:
    session_id = any_api.make_session()
    here = any_api.put_image(session_id, grey_png).json()["sha256"]
    ask = [
        {"pose_id": "P1", "sha256": here.upper()},
        {"pose_id": "P2", "sha256": here},
        {"pose_id": "P1", "sha256": "0" * 64},
        {"pose_id": "P1", "sha256": "0" * 64},
        *({"pose_id": "P1", "sha256": f"{n:064x}"} for n in range(1, 1200)),
    ]
    response = any_api.client.post(f"/v1/sessions/{session_id}/images/missing", json={"images": ask})
    assert response.status_code == 200, response.text
    assert response.json()["missing"] == [*ask[1:3], *ask[4:]]


@pytest.mark.parametrize(
    "body",
    [{}, {"images": [{"pose_id": "P1"}]}, {"images": [{"pose_id": "P1", "sha256": "x"}]}, {"images": {}}, []],
)
def test_a_wrong_question_for_missing_images_is_refused(api: Any, body: Any) -> None:
    response = api.client.post(f"/v1/sessions/{api.make_session()}/images/missing", json=body)
    assert response.status_code == 422


def test_interrupted_uploads_are_cleared_at_start(open_api: Any, tmp_path: Path) -> None:
    incoming = tmp_path / "data" / "originals" / "incoming"
    incoming.mkdir(parents=True)
    (incoming / "half").write_bytes(b"half a picture")
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
    assert api.client.post(missing, json=question).json() == {"missing": []}
    (original,) = files_of(api)
    for damage in (original.unlink, lambda: os.truncate(original, 10)):
        damage()
        assert api.client.post(missing, json=question).json()["missing"] == question["images"]
        again = api.put_image(session_id, grey_png)
        assert (again.status_code, again.json()["id"]) == (200, first["id"])
        assert original.read_bytes() == grey_png
        assert api.client.get(f"/v1/measurements/{first['id']}/image").content == grey_png
        assert files_of(api) == [original]


def test_a_folder_that_cannot_be_written_is_no_defect(api: Any, grey_png: bytes) -> None:
    session_id = api.make_session()
    folder = api.installation.blobs.path(hashlib.sha256(grey_png).hexdigest()).parent
    folder.rmdir()
    folder.write_text("in the way")
    refused = api.put_image(session_id, grey_png)
    assert (refused.status_code, refused.json()["code"]) == (507, "storage_full")
    folder.unlink()
    assert api.put_image(session_id, grey_png).status_code == 202


def test_too_many_open_files_are_not_called_a_full_disk() -> None:
    with pytest.raises(Unavailable), storage_refusals():
        raise OSError(errno.EMFILE, "Too many open files")


def test_a_misspelt_parameter_is_refused_before_it_is_lost(api: Any, grey_png: bytes) -> None:
    response = api.put_image(api.make_session(), grey_png, cylce=1)
    assert response.status_code == 422
    assert response.json()["errors"] == [{"field": "cylce", "message": "is not known"}]
    assert "cycle" in response.json()["advice"]
    assert files_of(api) == []
