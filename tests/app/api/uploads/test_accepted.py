"""Images that are taken: kept with their metadata, once for the same bytes, and given back whole."""

from __future__ import annotations

import hashlib
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from tests.support.image.image_encoders import tiff
from tests.support.image.images import encode
from tests.support.service.service import OCTETS
from tests.support.service.stored_files import files_of


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


def check_one_of_simultaneous(api: Any, session_id: str, image: bytes) -> None:
    """Six uploads of one image at the same moment make one measurement, and all are answered with it."""
    start = threading.Barrier(6)

    def send(_number: int) -> Any:
        start.wait()
        return api.put_image(session_id, image)

    with ThreadPoolExecutor(6) as pool:
        responses = list(pool.map(send, range(6)))
    assert sorted(r.status_code for r in responses) == [200] * 5 + [202]
    assert len({r.json()["id"] for r in responses}) == 1


def test_simultaneous_uploads_of_one_image_make_one_measurement(any_api: Any, grey_png: bytes) -> None:
    session_id = any_api.make_session()
    check_one_of_simultaneous(any_api, session_id, grey_png)


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


@pytest.mark.parametrize("extension", [".png", ".jpg", ".tiff", ".bmp"])
def test_every_format_is_taken(api: Any, extension: str) -> None:
    session_id = api.make_session()
    for image in (np.zeros((20, 30), np.uint8), np.zeros((20, 30, 3), np.uint8)):
        assert api.put_image(session_id, encode(extension, image)).status_code == 202


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
    assert (wrong.status_code, wrong.json()["code"]) == (422, "referenced_target_not_found")


def test_simultaneous_uploads_without_target_make_one_measurement(any_api: Any, grey_png: bytes) -> None:
    session_id = any_api.make_session(any_api.make_target(), any_api.make_target(columns=7))
    check_one_of_simultaneous(any_api, session_id, grey_png)


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
    assert any_api.client.patch(address, json={"target_ids": [one]}).status_code == 200
    again = any_api.put_image(session_id, grey_png, "P2")
    assert (again.status_code, again.json()) == (200, seeking.json())
    assert any_api.client.patch(address, json={"target_ids": [two]}).status_code == 200
    again = any_api.put_image(session_id, grey_png)
    assert (again.status_code, again.json()["id"]) == (200, alone["id"])


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
    assert response.json()["missing"] == [{**image, "target_id": None} for image in (*ask[1:3], *ask[4:])]


def test_missing_is_what_has_no_measurement_of_its_target(any_api: Any, grey_png: bytes) -> None:
    first, second = any_api.make_target(), any_api.make_target()
    session_id = any_api.make_session(first, second)
    sha256 = any_api.put_image(session_id, grey_png, target_id=first).json()["sha256"]
    ask = [{"pose_id": "P1", "sha256": sha256, "target_id": target} for target in (first, second, None)]

    def missing(images: list[dict[str, Any]]) -> Any:
        address = f"/v1/sessions/{session_id}/images/missing"
        return any_api.client.post(address, json={"images": images})

    assert missing(ask).json()["missing"] == ask[1:]
    assert any_api.put_image(session_id, grey_png).status_code == 202
    assert missing(ask).json()["missing"] == ask[1:2]
    assert any_api.put_image(session_id, grey_png, target_id=second).status_code == 202
    assert missing(ask).json()["missing"] == []
    refused = missing([ask[0], {**ask[0], "target_id": any_api.make_target()}])
    assert (refused.status_code, refused.json()["code"]) == (422, "referenced_target_not_found")
    assert [error["field"] for error in refused.json()["errors"]] == ["images.1.target_id"]


@pytest.mark.parametrize(
    "body",
    [{}, {"images": [{"pose_id": "P1"}]}, {"images": [{"pose_id": "P1", "sha256": "x"}]}, {"images": {}}, []],
)
def test_a_wrong_question_for_missing_images_is_refused(api: Any, body: Any) -> None:
    response = api.client.post(f"/v1/sessions/{api.make_session()}/images/missing", json=body)
    assert response.status_code == 422


@pytest.mark.parametrize("big", [False, True])
def test_a_tiff_with_its_directory_at_the_end_is_taken(api: Any, big: bool) -> None:
    rows = [bytes(4096) for _ in range(512)]
    data = tiff("<", rows, 8, 4096, 512, 1, big=big)
    response = api.put_image(api.make_session(), data)
    assert response.status_code == 202, response.text
