"""Images of two perpendicular grids, as in the corner of a room, with everything about them known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from core import Camera, TargetSpec
from core.geometry.camera import project
from core.geometry.se3 import compose, invert, transform, transform_points
from core.simulation import Scene
from tests.support.simulation.renders import render

CAMERA = Camera(1205.0, 1205.0, 642.0, 476.0, k1=-0.06)
SIZE_PX = (1280, 960)
_GAP_MM = 45.0
_MARGIN = 1.0  # white around the grids, pitches
_EDGE_PX = 8


@dataclass(frozen=True)
class Corner:
    """A grid on the wall ahead, and one on the wall to its right that faces left."""

    ahead: TargetSpec
    right: TargetSpec

    @property
    def T_ahead_right(self) -> Any:
        """The right grid's columns run toward the viewer."""
        a, b = self.ahead, self.right
        x, z = np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0])
        rotation = np.column_stack([x, np.cross(z, x), z])
        edge = (a.points_target()[:, 0].max()) + _MARGIN * a.pitch_mm + _GAP_MM
        return transform(rotation, np.array([edge, 0.0, -_MARGIN * b.pitch_mm - _GAP_MM]))

    def view(self, turn: float = 0.0, lift_mm: float = 0.0, near_mm: float = 0.0) -> Any:
        """T_camera_ahead of a camera in the room that looks into the corner; turned about its axis (rad)."""
        edge = self.T_ahead_right[:3, 3]
        at = np.array([edge[0] - 10.0, 60.0, -30.0])
        place = at + np.array([-370.0 + near_mm, lift_mm, -400.0 + near_mm])
        forward = (at - place) / np.linalg.norm(at - place)
        across = np.cross([0.0, 1.0, 0.0], forward)
        across /= np.linalg.norm(across)
        upright = np.column_stack([across, np.cross(forward, across), forward])
        c, s = np.cos(turn), np.sin(turn)
        rolled = upright @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return invert(transform(rolled, place))

    def scenes(self, T_camera_ahead: Any, *, seed: int = 0) -> tuple[Scene, Scene]:
        """The two grids, each by itself."""
        poses = (T_camera_ahead, compose(T_camera_ahead, self.T_ahead_right))
        return tuple(  # type: ignore[return-value]
            Scene(target, CAMERA, T, *SIZE_PX, noise_levels=2.0, seed=seed + k, quiet_zone=_MARGIN)
            for k, (target, T) in enumerate(zip((self.ahead, self.right), poses, strict=True))
        )

    def image(self, T_camera_ahead: Any, *, seed: int = 0) -> bytes:
        """A PNG with both in view."""
        ahead, right = self.scenes(T_camera_ahead, seed=seed)
        image = render(ahead)
        mask = np.zeros(image.shape, np.uint8)
        cv2.fillConvexPoly(mask, np.rint(_outline(right)).astype(np.int32), 1)
        mask = cv2.dilate(mask, np.ones((2 * _EDGE_PX + 1,) * 2, np.uint8))
        other = np.zeros(image.shape, np.uint8)
        cv2.fillConvexPoly(other, np.rint(_outline(ahead)).astype(np.int32), 1)
        assert not np.any(mask & other), "the sheets overlap in this view"
        return png(np.where(mask == 1, render(right), image))


def png(image: Any) -> bytes:
    written, data = cv2.imencode(".png", image)
    assert written
    return bytes(data)


def _outline(scene: Scene) -> Any:
    """Where the sheet's corners are, and half a margin more, which dots and markers reach into."""
    grid, pitch = scene.target.points_target(), scene.target.pitch_mm
    (x0, y0), (x1, y1) = grid[:, :2].min(axis=0), grid[:, :2].max(axis=0)
    far = (1.0 + _MARGIN) * pitch  # a chessboard's outer squares lie beyond its grid points
    corners = np.array(
        [
            [x0 - far, y0 - far, 0.0],
            [x1 + far, y0 - far, 0.0],
            [x1 + far, y1 + far, 0.0],
            [x0 - far, y1 + far, 0.0],
        ]
    )
    return project(transform_points(scene.T_camera_target, corners), scene.camera)
