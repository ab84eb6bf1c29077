"""What the cell's laser tracker adds to the story: kinematics, joint noise, compensation, and a history of weeks."""

from __future__ import annotations

from typing import Any

import numpy as np

from core.simulation import KR5_ARC_HOME
from tests.support.contract.requests import CSV, done, listed, report_made
from tests.support.sessions.kinematics import measured, readings
from tests.support.simulation.robots.repeated_poses import repeated_poses

_MEASURED_CSV = """\
pose_id,cycle,position_x_mm,position_y_mm,position_z_mm
F1,1,-520.112,107.704,-368.427
F1,2,-520.094,107.711,-368.440
"""


def tracker(client: Any, robot_id: str, target_id: str) -> None:
    """Identify the robot from what a laser tracker measured."""
    body = {"name": "Laser tracker", "target_ids": [target_id], "robot_id": robot_id}
    session_id = client.post("/v1/sessions", json=body).json()["id"]
    _, poses = measured()
    read = f"/v1/sessions/{session_id}/measured-poses"
    done(
        client.post(read, json=readings(poses)),
        *listed(client, read),
        client.get(f"/v1/sessions/{session_id}/dh", params={"source": "measured_poses"}),
        client.get(f"/v1/sessions/{session_id}/dh", params={"source": "measured_poses"}, headers=CSV),
        client.get(f"/v1/sessions/{session_id}/dh/error-map", params={"source": "measured_poses"}),
        client.get(
            f"/v1/sessions/{session_id}/dh/error-map", params={"source": "measured_poses"}, headers=CSV
        ),
        *_compensation(client, robot_id, session_id),
        client.post(read, content=_MEASURED_CSV, headers={"Content-Type": "text/csv"}),
        client.delete(read, params={"pose_id": poses.label(0)}),
    )


def joint_noise(client: Any, robot_id: str, target_id: str) -> None:
    """Predict repeatability from what a laser tracker measured of repeated poses."""
    body = {"name": "Ten poses, eight visits", "target_ids": [target_id], "robot_id": robot_id}
    path = f"/v1/sessions/{client.post('/v1/sessions', json=body).json()['id']}"
    visits = 8
    _, poses, _ = repeated_poses(21, poses=10, visits=visits)
    rows = [{**row, "cycle": i % visits + 1} for i, row in enumerate(readings(poses))]
    asked = {"source": "measured_poses", "at": ",".join(map(str, np.degrees(KR5_ARC_HOME).round(3).tolist()))}
    noise = f"{path}/joint-noise"
    done(
        client.post(f"{path}/measured-poses", json=rows),
        client.get(noise, params=asked),
        client.get(noise, params=asked, headers=CSV),
        client.get(f"{noise}/map.svg", params={"source": "measured_poses"}),
    )


def _compensation(client: Any, robot_id: str, session_id: str) -> list[Any]:
    """Correct two commands by what the tracker's session identified: one within its region, one outside."""
    home = np.degrees(KR5_ARC_HOME)
    commands = {
        "session_id": session_id,
        "source": "measured_poses",
        "poses": [
            {"pose_id": "P1", "joint_angles_deg": (home + 5.0).tolist()},
            {"pose_id": "P2", "joint_angles_deg": [home[0] + 170.0, *home[1:].tolist()]},
        ],
    }
    path = f"/v1/robots/{robot_id}/compensate"
    return [client.post(path, json=commands), client.post(path, json=commands, headers=CSV)]


def history(client: Any, robot_id: str, target_id: str) -> None:
    """Measure two poses each week with a laser tracker, file a report of each session, and look at the history."""
    rng, made = np.random.default_rng(5), []
    for week in range(5):
        body = {"name": f"Week {week + 1}", "target_ids": [target_id], "robot_id": robot_id}
        path = f"/v1/sessions/{client.post('/v1/sessions', json=body).json()['id']}"
        rows = [
            {
                "pose_id": f"P{pose + 1}",
                "cycle": cycle + 1,
                "position_mm": (1000.0 * pose + rng.normal(0.0, 0.02, 3)).round(4).tolist(),
            }
            for pose in range(2)
            for cycle in range(10)
        ]
        done(client.post(f"{path}/measured-poses", json=rows))
        made.append(
            report_made(client, done(client.post(f"{path}/reports", json={"kind": "repeatability"})).json())
        )
    history, compared = (
        f"/v1/robots/{robot_id}/history",
        f"{made[0]}/comparison/{made[-1].rpartition('/')[2]}",
    )
    done(*(client.get(path, headers=headers) for path in (history, compared) for headers in (CSV, {})))
    done(client.get(f"{history}.svg"))
