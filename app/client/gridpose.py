"""The service for programs: `Gridpose` and its sessions, each call typed, with retries and waiting.

with Gridpose("http://measuring-pc:8000", key) as gridpose:
    session = gridpose.session("Cell 7", target="chessboard:9x6:25")
    session.upload("images")
    session.wait()
    for row in session.repeatability().rows:
        print(row["pose_id"], row["repeatability.rp_l_mm"])
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from .closing import Closing
from .credentials import find_key, usual_address
from .http import ClientError, Json, ServiceClient
from .images.files import plan_files
from .images.upload import UploadResult, upload_files
from .resources import find_or_make_session, find_or_make_target, find_robot
from .results import Analysis, Measurement

_POLL_S = (0.2, 2.0)


class Gridpose(Closing):
    """A service.

    Parameters
    ----------
    url
        Its address; by default GRIDPOSE_URL, else that of the last `gridpose login`, else this machine.
    key
        An API key; by default that of GRIDPOSE_KEY, GRIDPOSE_KEY_FILE, or `gridpose login`.
    retry_for_s
        How long a request is repeated while the service is down or busy.

    Raises
    ------
    ClientError
        The address or the key is impossible. Every method raises it for what the service refuses.
    """

    def __init__(self, url: str | None = None, key: str | None = None, *, retry_for_s: float = 300.0) -> None:
        key_given = any((key, os.environ.get("GRIDPOSE_KEY"), os.environ.get("GRIDPOSE_KEY_FILE")))
        self.url = url or os.environ.get("GRIDPOSE_URL") or usual_address(key_given=key_given)
        self.client = ServiceClient(self.url, key or find_key(self.url), retry_for_s=retry_for_s)

    def close(self) -> None:
        """Close the connections."""
        self.client.close()

    def sessions(self) -> list[Session]:
        """Return all sessions, oldest first."""
        return [Session(self.client, found["id"]) for found in self.client.items("/v1/sessions")]

    def session(self, session: str, *, target: str | None = None) -> Session:
        """Return the session with this id or name; a new name makes one, given its `target` (id, name or form)."""
        session_id, target_id = find_or_make_session(self.client, session, target)
        return Session(self.client, session_id, target_id)

    def targets(self) -> list[Json]:
        """Return all targets, oldest first."""
        return list(self.client.items("/v1/targets"))

    def target(self, target: str) -> str:
        """Return the id of the target with this id, name or form, e.g. `chessboard:9x6:25`, made where it is new."""
        return find_or_make_target(self.client, target)

    def robots(self) -> list[Json]:
        """Return all robots, oldest first."""
        return list(self.client.items("/v1/robots"))

    def robot(self, robot: str) -> Json:
        """Return the robot with this id or name."""
        return find_robot(self.client, robot)


class Session:
    """A session of a service. `id` is its id."""

    def __init__(self, client: ServiceClient, session_id: str, target_id: str | None = None) -> None:
        self.id = session_id
        self._client = client
        self._target_id = target_id

    def document(self) -> Json:
        """Return the session as the service answers it: name, targets, counts."""
        return self._client.get(f"/v1/sessions/{self.id}")

    def upload(
        self,
        folder: str | Path,
        *,
        pattern: str | None = None,
        pose_id: str | None = None,
        parallel: int = 2,
        on_done: Callable[[UploadResult], None] = lambda result: None,
    ) -> list[UploadResult]:
        """Send a folder's images, once each, and return what became of each file; repeated, it sends what is missing.

        Sub-folders are poses, or `pattern` has their place (`{pose}_{cycle}`). `on_done` is called for each file.
        """
        plan = plan_files(Path(folder), pattern, pose_id)
        return upload_files(
            self._client,
            self.id,
            plan.images,
            target_id=self._target_id,
            parallel=parallel,
            on_done=on_done,
        )

    def put_poses(self, poses: Sequence[Mapping[str, Any]], *, accept_implausible: bool = False) -> None:
        """Store commanded poses, all or none: `pose_id`, and `position_mm`, `roll_deg`, ..., `joint_angles_deg`.

        Values that look like metres or radians are refused (`implausible_unit`) unless accepted.
        """
        self._client.put_poses(self.id, [dict(pose) for pose in poses], accept_implausible=accept_implausible)

    def wait(self, *, timeout_s: float = 3600.0) -> list[Measurement]:
        """Wait until no image is queued or running, and return all measurements.

        Raises ClientError `no_progress` after `timeout_s`.
        """
        deadline = time.monotonic() + timeout_s
        pause_s, longest_s = _POLL_S
        while True:
            counts = self.document()["counts"]
            waiting = counts["queued"] + counts["running"]
            if not waiting:
                return self.measurements()
            if time.monotonic() >= deadline:
                raise ClientError(
                    "no_progress",
                    f"{waiting} images are still waiting after {timeout_s:g} s.",
                    "Check that a worker runs: see /readyz.",
                )
            time.sleep(pause_s)
            pause_s = min(1.5 * pause_s, longest_s)

    def measurements(self) -> list[Measurement]:
        """Return all measurements, oldest first."""
        return [Measurement.of(m) for m in self._client.items(f"/v1/sessions/{self.id}/measurements")]

    def repeatability(self, /, **options: Any) -> Analysis:
        """Return the repeatability of ISO 9283; `options` are those of the analysis, e.g. `estimator="pooled"`."""
        return self._analysis("repeatability", options)

    def intrinsics(self, /, **options: Any) -> Analysis:
        """Return the camera of all images together."""
        return self._analysis("intrinsics", options)

    def camera_poses(self, /, **options: Any) -> Analysis:
        """Return the camera's pose in every image whose points were found."""
        return self._analysis("camera-poses", options)

    def hand_eye(self, /, **options: Any) -> Analysis:
        """Return the camera on the flange and the target in the base, from commanded poses."""
        return self._analysis("hand-eye", options)

    def dh(self, /, **options: Any) -> Analysis:
        """Return the robot's Denavit-Hartenberg parameters."""
        return self._analysis("dh", options)

    def comparison(self, /, **options: Any) -> Analysis:
        """Return the published methods next to this one."""
        return self._analysis("comparison", options)

    def save_overlay(self, measurement_id: str, path: str | Path) -> Path:
        """Write an image with the points found in it as PNG, and return the path."""
        return self._save(f"/v1/measurements/{measurement_id}/overlay", path)

    def save_plot(self, name: str, path: str | Path) -> Path:
        """Write a plot of the session as SVG, e.g. `repeatability/scatter`, and return the path."""
        return self._save(f"/v1/sessions/{self.id}/{name}.svg", path)

    def delete(self) -> None:
        """Delete the session with everything in it; this needs a key of scope admin."""
        self._client.delete(f"/v1/sessions/{self.id}")

    def _analysis(self, kind: str, options: Mapping[str, Any]) -> Analysis:
        return Analysis(kind, self._client.get(f"/v1/sessions/{self.id}/{kind}", **options))

    def _save(self, address: str, path: str | Path) -> Path:
        path = Path(path)
        path.write_bytes(self._client.get_bytes(address))
        return path
