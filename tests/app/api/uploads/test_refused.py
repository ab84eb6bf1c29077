"""Uploads that are refused by what they hold: forms, metadata, hashes, formats, sizes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.support.service.service import OCTETS, image_address
from tests.support.service.stored_files import bomb, files_of


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
        ({"pose_id": "P1"}, {"photograph": b"x"}, "photograph"),
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


def test_a_form_that_is_cut_short_and_one_with_a_long_head_are_distinguished(api: Any) -> None:
    part = b'--B\r\nContent-Disposition: form-data; name="image"; filename="x"\r\n'
    said = [
        api.client.post(
            f"/v1/sessions/{api.make_session()}/images",
            content=body,
            headers={"Content-Type": "multipart/form-data; boundary=B"},
        ).json()
        for body in (
            part + b"\r\nabc",
            part + b"X-Long: " + b"a" * 20_000 + b"\r\n\r\nabc\r\n--B--\r\n",
            b"no",
        )
    ]
    assert {one["code"] for one in said} == {"invalid_form"}
    assert len({one["errors"][0]["message"] for one in said}) == 3


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


@pytest.mark.slow
@pytest.mark.parametrize("sha256", ["abc", "g" * 64, "0" * 63, "0" * 65, "0" * 64 + "%0A"])
def test_what_is_no_hash_is_refused(api: Any, sha256: str) -> None:
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


def test_a_misspelt_parameter_is_refused_before_it_is_lost(api: Any, grey_png: bytes) -> None:
    response = api.put_image(api.make_session(), grey_png, cylce=1)
    assert response.status_code == 422
    assert response.json()["errors"] == [{"field": "cylce", "message": "is not known"}]
    assert "cycle" in response.json()["advice"]
    assert files_of(api) == []


def test_a_parameter_given_twice_is_refused(api: Any, grey_png: bytes) -> None:
    address = image_address(api.make_session(), grey_png)
    response = api.client.put(f"{address}?cycle=1&cycle=2", content=grey_png, headers=OCTETS)
    assert (response.status_code, response.json()["code"]) == (422, "invalid_request")
    assert response.json()["errors"] == [{"field": "cycle", "message": "is given more than once"}]
    assert files_of(api) == []


def test_a_form_takes_no_metadata_from_its_address(api: Any, grey_png: bytes) -> None:
    address = f"/v1/sessions/{api.make_session()}/images"
    response = api.client.post(
        f"{address}?cycle=1", data={"pose_id": "P1"}, files={"image": ("x.png", grey_png, "image/png")}
    )
    assert (response.status_code, response.json()["code"]) == (422, "invalid_request")
    assert response.json()["errors"] == [{"field": "cycle", "message": "is not known"}]
    assert files_of(api) == []
