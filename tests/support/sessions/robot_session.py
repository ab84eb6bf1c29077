"""One session of a robot that carries a camera, of which every analysis can be asked."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from core.geometry.se3 import invert
from core.kinematics.dh import forward
from core.simulation.arm import KR5_ARC_HOME, Arm, free_angles, kr5_arc, sweep_angles
from tests.support.sessions.kinematics import make_robot
from tests.support.sessions.stored_sessions import (
    Shot,
    draw_board_pose,
    look,
    new_session,
    store_shots,
)

SETTINGS = {
    "estimator": "pooled",
    "source": "images",
    "method": "global",
    "model": "auto",
    "joint_tolerance_deg": "0.02",
}
"""Of all analyses together: each takes its own."""
ANALYSES = ("intrinsics", "camera-poses", "hand-eye", "repeatability", "dh", "comparison")
FORMULA = '=HYPERLINK("http://x")'


@dataclass(frozen=True)
class RobotSession:
    """A session whose images are named and timed; of the ids, the last is excluded by the user."""

    api: Any
    id: str
    robot_id: str
    measurement_ids: tuple[str, ...]

    def get(self, analysis: str, accept: str = "application/json", **query: str) -> Any:
        response = self.api.client.get(
            f"/v1/sessions/{self.id}/{analysis}", params=query, headers={"Accept": accept}
        )
        assert response.status_code == 200, response.text
        return response


def store_robot_session(api: Any) -> RobotSession:
    """A KR5 swept joint by joint and moved freely before one board, each pose visited twice."""
    rng = np.random.default_rng(5)
    arm = kr5_arc(rng)
    at_home = forward(arm.chain, KR5_ARC_HOME[None])[0] @ arm.T_flange_camera
    base = invert(draw_board_pose(rng, 25.0)) @ invert(at_home)
    arm = Arm(arm.chain, base[None], arm.T_flange_camera)
    half_range = math.radians(8.0)
    q = np.concatenate(
        [
            sweep_angles(KR5_ARC_HOME, half_arc=half_range, steps=3),
            free_angles(rng, KR5_ARC_HOME, 10, half_range=half_range),
        ]
    )
    robot_id = make_robot(api)
    session = new_session(api, robot_id=robot_id)
    commanded = [
        {"pose_id": f"P{i + 1}", "joint_angles_deg": np.degrees(angles).tolist()}
        for i, angles in enumerate(q)
    ]
    assert api.client.post(f"/v1/sessions/{session}/poses", json=commanded).status_code == 200
    shots = []
    for cycle in (1, 2):
        for i, T in enumerate(arm.camera_poses(q, np.zeros(len(q), dtype=np.intp))):
            name = FORMULA if (cycle, i) == (2, len(q) - 1) else f"P{i + 1}_{cycle}.png"
            shot = Shot(f"P{i + 1}", cycle, look(rng, invert(T)), T, {"filename": name})
            shots.append(dataclasses.replace(shot, points=in_view(shot)))
    ids = store_shots(api, session, shots)
    change = {"excluded": {"reason": "+1 hand in view"}}
    assert api.client.patch(f"/v1/measurements/{ids[-1]}", json=change).status_code == 200
    return RobotSession(api, session, robot_id, tuple(ids))


def in_view(shot: Shot) -> Any:
    """The points of a board that is not far out of the image, where the lens model bends back; else none."""
    points = shot.points
    assert points is not None
    size = np.array([points.image_width_px, points.image_height_px])
    near = np.all(points.points_px >= -size) and np.all(points.points_px <= 2.0 * size)
    return points if near else None
