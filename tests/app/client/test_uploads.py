"""Copies of an image in one folder, and names that several sessions have."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, cast

import pytest

from app.client import ClientError, ImageFile, ServiceClient, upload_files
from app.client.resources.finding import existing_session


class Lacking:
    """A service that lacks every image, and refuses them or not."""

    def __init__(self, *, refuses: bool) -> None:
        self.refuses = refuses
        self.sent = 0

    def missing_images(self, _session: str, images: Any, **_: Any) -> set[tuple[str, str]]:
        return set(images)

    def put_image(self, *_: Any, **__: Any) -> None:
        self.sent += 1
        if self.refuses:
            raise ClientError("not_an_image", "This is no image.", status=415)


@pytest.mark.parametrize(
    ("refuses", "statuses"), [(False, ["sent", "present"]), (True, ["failed", "failed"])]
)
def test_a_copy_is_where_the_first_one_is(tmp_path: Path, refuses: bool, statuses: list[str]) -> None:
    files = []
    for cycle in (1, 2):
        path = tmp_path / f"{cycle}.png"
        path.write_bytes(b"the same")
        files.append(ImageFile(path, path.name, "P1", cycle))
    service = Lacking(refuses=refuses)
    found = upload_files(cast(ServiceClient, service), "ses_1", files)
    assert [one.status for one in found] == statuses
    assert [one.file for one in found] == files
    assert service.sent == 1


class Named:
    """A service with many sessions of one name."""

    def items(self, _path: str, **_: Any) -> list[dict[str, str]]:
        return [{"id": f"ses_{k}"} for k in range(1000)]


def test_a_name_of_many_sessions_lists_a_few() -> None:
    with pytest.raises(ClientError) as caught:
        existing_session(cast(ServiceClient, Named()), "shift 4")
    assert caught.value.code == "session_ambiguous"
    assert "ses_4" in caught.value.detail
    assert "ses_5" not in caught.value.detail


def test_a_file_larger_than_memory_fails_and_hinders_no_other(tmp_path: Path) -> None:
    files = []
    for cycle, size in ((1, 1 << 40), (2, 8)):
        path = tmp_path / f"{cycle}.png"
        path.touch()
        os.truncate(path, size)
        files.append(ImageFile(path, path.name, "P1", cycle))
    found = upload_files(cast(ServiceClient, Lacking(refuses=False)), "ses_1", files)
    assert [one.status for one in found] == ["failed", "sent"]
    assert found[0].reason == "cannot be read: it is larger than 1 GiB, as no image is"
