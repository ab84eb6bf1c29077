"""Inputs of an analysis: one session's measurements and their results in a fixed order, and the hash of all of them.

The hash identifies a set of inputs. It holds neither ids, nor times, nor the order of arrival, so that the same images,
tags and settings have the same hash in any session of any installation.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import datetime
from typing import Any

from app.build import core_version
from core.session import CameraMount, CommandedPose, ImageObservation, natural

ROBOT_ANALYSES = frozenset(
    {
        *("dh", "hand_eye", "compensation", "joint_noise", "kinematic_error"),
        *("joint_noise_map", "joint_curves_plot", "error_map", "identifiability_plot"),
    }
)
"""Those that are computed from the robot's nominal joints, too."""


@dataclass(frozen=True, slots=True)
class StoredImage:
    """What came of a measurement, as it is stored.

    `content_sha256` covers its grid points and markers; it is None if nothing was computed. `labelling` is that of its
    grid points; it is None without grid points and for results older than the column. `stated_target_id` is the target
    that the upload named, where the measurement is of another one.
    """

    observation: ImageObservation
    point_bytes: int | None
    computed_by: str | None
    content_sha256: str | None = None
    labelling: str | None = None
    captured_at: datetime | None = None
    received_at: datetime | None = None
    stated_target_id: str | None = None


@dataclass(frozen=True, slots=True)
class StoredPose:
    """A pose that another instrument measured, by the hash of what it read."""

    measurement_id: str
    pose_id: str
    cycle: int | None
    content_sha256: str


@dataclass(frozen=True, slots=True)
class Snapshot:
    """One session at one moment, without its arrays. `images` are in the order of pose (natural), cycle, hash and
    target; those without a cycle follow those with one. `pending` measurements are not finished: they are not among
    them, but for those that are computed again, whose earlier results stand.

    Where an analysis is of another instrument's poses, `measured` are those in the same order, and there are no images.
    `measured_instead` says that an analysis of images finds none, while there are such poses.
    `robot` are the nominal parameters of the session's joints, `joint_coupling` how these are coupled, `datasheet` what
    its maker states, `camera_mount` what the camera is on. `subject` is what answers say they are about.
    """

    session_id: str
    target_ids: tuple[str, ...]
    targets: tuple[dict[str, Any], ...]
    lens: dict[str, float] | None
    intrinsics: dict[str, float] | None
    commanded: Mapping[str, CommandedPose]
    images: tuple[StoredImage, ...]
    pending: int
    measured: tuple[StoredPose, ...] = ()
    robot: list[dict[str, float]] | None = None
    joint_coupling: list[list[float]] | None = None
    datasheet: Mapping[str, float | None] = field(default_factory=dict)
    subject: Mapping[str, Any] = field(default_factory=dict)
    camera_mount: CameraMount = "robot"
    measured_instead: bool = False

    def answer_sha256(self, inputs_sha256: str) -> str:
        """Return the hash of all that an answer is made of: its inputs by their hash, and ids, names and times."""
        parts = [
            inputs_sha256,
            self.pending,
            self.subject,
            [
                [
                    *(image.observation.measurement_id, image.observation.filename),
                    *(str(image.captured_at), str(image.received_at)),
                    *([image.stated_target_id] if image.stated_target_id is not None else []),
                ]
                for image in self.images
            ],
            [pose.measurement_id for pose in self.measured],
        ]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()

    def inputs_sha256(self, analysis: str, settings: Mapping[str, Any]) -> str:
        """Return the hash of everything that `analysis` with `settings` is computed from, this program included."""
        inputs = {
            "analysis": analysis,
            "settings": dict(settings),
            "core_version": core_version(),
            "lens": self.lens,
            "intrinsics": self.intrinsics,
            "targets": self.targets,
            "poses": [
                [pose_id, asdict(self.commanded[pose_id])] for pose_id in sorted(self.commanded, key=natural)
            ],
            "images": [
                [
                    image.observation.pose_id,
                    image.observation.cycle,
                    image.observation.image,
                    image.observation.target,
                    image.observation.focus_group,
                    image.observation.joint_angles_deg,
                    image.observation.failure_code,
                    self._without_ids(image.observation.failure_detail),
                    image.computed_by,
                    image.content_sha256,
                    image.labelling,
                    # Without one, the hash is that of versions before it.
                    *([["burst", image.observation.burst]] if image.observation.burst is not None else []),
                ]
                for image in self.images
            ],
            "measured": [[m.pose_id, m.cycle, m.content_sha256] for m in self.measured],
            "robot": self.robot if analysis in ROBOT_ANALYSES else None,
            "joint_coupling": self.joint_coupling if analysis in ROBOT_ANALYSES else None,
            "datasheet": dict(self.datasheet) if analysis == "repeatability" else None,
            # With the camera on the robot, the hash is that of versions before it; other instruments have no mount.
            **({"camera_mount": "fixed"} if self.camera_mount == "fixed" and not self.measured else {}),
            **({"measured_instead": True} if self.measured_instead else {}),
        }
        text = json.dumps(inputs, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()

    def _without_ids(self, text: str | None) -> str | None:
        """Return a refusal's text, which analyses show, with the session's targets named by their places."""
        if text is not None and "_" in text:
            for place, target_id in enumerate(self.target_ids):
                text = text.replace(target_id, f"<{place}>")
        return text
