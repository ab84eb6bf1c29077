"""Overlays and thumbnails through the interface: one for every image, whatever came of it."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import cv2
import numpy as np
import pytest

from app.api.representations import preferred_media_type, stated_media_type
from app.blobs.thumbnails import thumbnail_path
from core.simulation.renderer import render
from core.targets.specification import TargetSpec
from tests.support.image.images import encode
from tests.support.service.service import ApiMaker
from tests.support.simulation.scenes import standard_scene

PNG, WEBP = "image/png", "image/webp"


def flat_png() -> bytes:
    """Return an untilted board, of which the points are found and no camera is."""
    return encode(
        ".png", render(standard_scene(TargetSpec("chessboard", 9, 6, 25.0), seed=3, tilt=0.0, clutter=0.0))
    )


def cut_png() -> bytes:
    """Return a photograph whose file ends half-way."""
    noise = np.random.default_rng(1).integers(0, 255, (480, 640)).astype(np.uint8)
    data = encode(".png", noise)
    return data[: len(data) // 2]


def nothing_png() -> bytes:
    """Return a photograph without a board."""
    return encode(".png", np.full((480, 640), 90, np.uint8))


@pytest.mark.parametrize(
    ("image", "code"),
    [
        pytest.param(flat_png, "focal_not_observable", marks=pytest.mark.slow),
        (nothing_png, "target_not_found"),
        (cut_png, "undecodable_image"),
    ],
)
def test_every_refused_image_has_an_overlay_and_a_thumbnail(
    computing_api: Any, image: Callable[[], bytes], code: str
) -> None:
    session_id = computing_api.make_session()
    measurement = computing_api.wait_for(computing_api.put_image(session_id, image()).json()["id"])
    assert measurement["failure"]["code"] == code
    address = f"/v1/measurements/{measurement['id']}"
    for width in (320, 800):
        overlay = computing_api.client.get(f"{address}/overlay", params={"width": width})
        assert (overlay.status_code, overlay.headers["content-type"]) == (200, PNG)
        assert overlay.headers["vary"] == "Accept"
        known = {"If-None-Match": overlay.headers["etag"]}
        again = computing_api.client.get(f"{address}/overlay", params={"width": width}, headers=known)
        assert (again.status_code, again.content) == (304, b"")
        drawn = cv2.imdecode(np.frombuffer(overlay.content, np.uint8), cv2.IMREAD_COLOR).astype(int)
        assert drawn.shape[1] == width
        red = (drawn[..., 2] > 150) & (drawn[..., 1] < 90) & (drawn[..., 0] < 90)
        assert red[round(0.75 * width) :].sum() > width  # the verdict
    webp = computing_api.client.get(f"{address}/overlay", headers={"Accept": "image/avif,image/webp,*/*"})
    assert (webp.headers["content-type"], webp.content[8:12]) == (WEBP, b"WEBP")
    thumbnail = computing_api.client.get(f"{address}/thumbnail")
    assert (thumbnail.status_code, thumbnail.headers["content-type"]) == (200, WEBP)
    assert {"private", "immutable"} <= set(thumbnail.headers["cache-control"].split(", "))


def test_the_points_of_a_measured_image_are_drawn_in_their_places(
    computing_api: Any, board_png: bytes
) -> None:
    accepted = computing_api.put_image(computing_api.make_session(), board_png).json()
    waiting = computing_api.client.get(f"/v1/measurements/{accepted['id']}/overlay")
    assert waiting.status_code == 200
    measurement = computing_api.wait_for(accepted["id"])
    address = f"/v1/measurements/{measurement['id']}"
    response = computing_api.client.get(f"{address}/overlay", params={"width": 1600})
    drawn = cv2.imdecode(np.frombuffer(response.content, np.uint8), cv2.IMREAD_COLOR).astype(int)
    scale = 1600 / 2448
    for point in computing_api.client.get(f"{address}?include=points").json()["points"]:
        u, v = (round((point[name] + 0.5) * scale - 0.5) for name in ("u_px", "v_px"))
        around = drawn[v - 16 : v + 17, u - 16 : u + 17]
        assert (around.max(axis=2) - around.min(axis=2)).max() > 60


@pytest.mark.parametrize("width", ["0", "159", "2401", "1e3", "800.5", "wide"])
def test_a_width_out_of_bounds_is_refused(computing_api: Any, width: str) -> None:
    accepted = computing_api.put_image(computing_api.make_session(), nothing_png()).json()
    response = computing_api.client.get(f"/v1/measurements/{accepted['id']}/overlay", params={"width": width})
    assert (response.status_code, response.json()["code"]) == (422, "invalid_request")


def test_a_file_without_a_pixel_is_a_problem_with_a_code(computing_api: Any) -> None:
    data = encode(".bmp", np.full((480, 640), 90, np.uint8))[:3000]
    session_id = computing_api.make_session()
    accepted = computing_api.put_image(session_id, data)
    assert accepted.status_code == 202, accepted.text
    computing_api.wait_for(accepted.json()["id"])
    for form in ("overlay", "thumbnail"):
        response = computing_api.client.get(f"/v1/measurements/{accepted.json()['id']}/{form}")
        assert (response.status_code, response.json()["code"]) == (409, "undecodable_image")
        assert response.headers["content-type"] == "application/problem+json"


def test_a_thumbnail_is_made_once_and_removed_with_its_original(computing_api: Any) -> None:
    session_id = computing_api.make_session()
    image = encode(".png", np.full((480, 640), 91, np.uint8))
    accepted = computing_api.put_image(session_id, image).json()
    computing_api.wait_for(accepted["id"])
    blobs = computing_api.service.installation.blobs
    file = thumbnail_path(blobs.thumbnails.root, accepted["sha256"])
    assert not file.exists()
    address = f"/v1/measurements/{accepted['id']}/thumbnail"
    first = computing_api.client.get(address)
    assert file.read_bytes() == first.content
    file.write_bytes(b"kept")
    assert computing_api.client.get(address).content == b"kept"
    assert computing_api.client.delete(f"/v1/sessions/{session_id}").status_code == 204
    assert not file.exists()
    assert not blobs.path(accepted["sha256"]).exists()


@pytest.mark.slow
def test_a_page_of_sixty_thumbnails_is_drawn_at_once(serve_api: ApiMaker) -> None:
    with serve_api() as api:
        session_id = api.make_session()
        images = [encode(".png", np.full((48, 64), level, np.uint8)) for level in range(60)]
        ids = [api.put_image(session_id, image).json()["id"] for image in images]
        with ThreadPoolExecutor(len(ids)) as browser:
            answers = list(browser.map(lambda i: api.client.get(f"/v1/measurements/{i}/thumbnail"), ids))
    assert {(a.status_code, a.content[8:12]) for a in answers} == {(200, b"WEBP")}


@pytest.mark.parametrize(
    ("accept", "expected"),
    [
        (None, PNG),
        ("*/*", PNG),
        ("image/webp", WEBP),
        ("image/png, image/webp", WEBP),
        ("image/png, image/webp;q=0.5", PNG),
        ("image/webp;q=0", PNG),
        ("image/webp;q=x", PNG),
        ("text/html,image/avif,image/webp,image/apng,*/*;q=0.8", WEBP),
        (",;,", PNG),
    ],
)
def test_webp_is_for_those_who_prefer_it(accept: str | None, expected: str) -> None:
    assert preferred_media_type(accept) == expected


@pytest.mark.parametrize(
    ("accept", "stated"),
    [
        (None, PNG),
        ("application/octet-stream", "application/octet-stream"),
        ("application/octet-stream, image/png", PNG),
        ("application/octet-stream, image/*;q=0.5", "application/octet-stream"),
        ("application/octet-stream;q=0.1, */*", PNG),
        ("application/octet-stream;q=0", PNG),
    ],
)
def test_an_image_is_declared_as_bytes_where_these_are_preferred(accept: str | None, stated: str) -> None:
    assert stated_media_type(accept, PNG) == stated
