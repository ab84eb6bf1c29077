"""What a watcher asks of a service, answered at once and without one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any


class InstantService:
    """A service that stores and measures at once."""

    def __init__(self) -> None:
        self.stored: Counter[tuple[str, str]] = Counter()

    def missing_images(
        self, session_id: str, images: list[tuple[str, str]], **_: Any
    ) -> set[tuple[str, str]]:
        return {image for image in images if image not in self.stored}

    def put_image(
        self, session_id: str, pose_id: str, sha256: str, data: bytes, **metadata: Any
    ) -> dict[str, Any]:
        self.stored[pose_id, sha256] += 1
        return {"id": f"mea_{sha256}", "cycle": metadata.get("cycle")}

    def items(self, path: str, **_: Any) -> Iterator[dict[str, Any]]:
        return iter(())

    def get(self, path: str) -> dict[str, Any]:
        return {
            "status": "succeeded",
            "failure": None,
            "capture_quality": None,
            "calibration": {"reprojection": {"points": 54, "rms_px": 0.1}},
            "pose_id": "P1",
            "cycle": None,
            "burst": None,
        }
