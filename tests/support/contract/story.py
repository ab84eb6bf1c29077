"""One small robot cell from its first target to its last key, through the real application: each operation once.

A KUKA KR5 with a camera on its flange returns ten times to two poses and once to six others before a chessboard; a
laser tracker follows it through sweeps of its joints. Images are rendered and measured by a worker process.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from core.simulation import KR5_ARC, KR5_ARC_HOME, T_FLANGE_CAMERA
from tests.support.contract.cell import CAMERA, SIZE_PX, TARGET, take_images
from tests.support.contract.contract import Operation
from tests.support.image.images import small_image
from tests.support.service.service import OCTETS, Api, image_address, wait_until
from tests.support.sessions.kinematics import measured, readings, rows_of
from tests.support.simulation.robots.repeated_poses import repeated_poses

_UNKNOWN = {"pose_id": "P1", "sha256": "0" * 64}
POSES, REPEATED, CYCLES = 8, 2, 10
_TIMEOUT_S = 300.0
_CSV = {"Accept": "text/csv"}
_COMMANDED_CSV = """\
pose_id,position_x_mm,position_y_mm,position_z_mm,roll_deg,pitch_deg,yaw_deg
P1,907.414705,88.985509,838.684919,158.296313,28.925181,73.836431
P9,850.0,0.0,700.0,180.0,0.0,0.0
"""
_MEASURED_CSV = """\
pose_id,cycle,position_x_mm,position_y_mm,position_z_mm
F1,1,-520.112,107.704,-368.427
F1,2,-520.094,107.711,-368.440
"""


def use_every_operation(api: Api) -> None:
    """Go through every operation that succeeds; the last answer of each is the one that reads best."""
    client = api.client
    robot_id = _create(
        client,
        "/v1/robots",
        {
            "name": "KR 5 arc, cell 4",
            "joints": rows_of(KR5_ARC),
            "manufacturer": "KUKA",
            "model": "KR 5 arc",
            "datasheet_repeatability_mm": 0.1,
        },
    )
    _done(client.patch(f"/v1/robots/{robot_id}", json={"serial_number": "412", "datasheet_accuracy_mm": 0.6}))
    _events(client, robot_id)
    target_id = _create(client, "/v1/targets", TARGET)
    known = {
        "certificate": {
            "number": "D-K-4711",
            "issued_on": "2026-03-14",
            "pitch_x_mm": TARGET["pitch_mm"],
            "pitch_y_mm": TARGET["pitch_mm"],
            "standard_uncertainty": {"pitch_x_mm": 0.002, "pitch_y_mm": 0.002, "squareness_mrad": 0.05},
        },
        "print_kind": "plate",
    }
    _done(client.patch(f"/v1/targets/{target_id}", json=known))
    session_id = _create(
        client,
        "/v1/sessions",
        {
            "name": "Cell 4",
            "target_ids": [target_id],
            "robot_id": robot_id,
            "lens": {"focal_length_mm": 4.5, "pixel_pitch_um": 6.9},
        },
    )
    for kind, row_id in (("targets", target_id), ("robots", robot_id)):
        _done(client.get(f"/v1/{kind}/{row_id}"), *_listed(client, f"/v1/{kind}"))
    _history(client, robot_id, target_id)  # first: later answers of the same operations read better
    _removals(client)
    _images(client, session_id)
    _analyses(client, session_id)
    _tracker(client, robot_id, target_id)
    _joint_noise(client, robot_id, target_id)
    plan = {
        "target_id": target_id,
        "camera": {
            **{"fx_px": CAMERA.fx_px, "fy_px": CAMERA.fy_px, "cx_px": CAMERA.cx_px, "cy_px": CAMERA.cy_px},
            **{"k1": CAMERA.k1, "k2": CAMERA.k2, "image_width_px": SIZE_PX[0], "image_height_px": SIZE_PX[1]},
        },
        "home_deg": np.degrees(KR5_ARC_HOME).tolist(),
        "T_flange_camera": T_FLANGE_CAMERA.tolist(),
        "sweeps": {"sweep_half_angle_deg": 15.0, "steps": 5},
        "random_poses": 10,
        "random_half_range_deg": 8.0,
        "image_coverage": 0.4,
        "suggest_count": 2,
        "candidate_count": 20,
    }
    _done(*(client.post(f"/v1/robots/{robot_id}/dh-plan", json=plan, headers=form) for form in (_CSV, {})))
    _reports(client, session_id)
    _webhooks(client)
    _keys(client, session_id)
    _done(*_listed(client, "/v1/audit"), *(client.get(path) for path in ("/livez", "/readyz", "/metrics")))


def _events(client: Any, robot_id: str) -> None:
    """Note what was done to a robot, and delete what was noted in error."""
    path = f"/v1/robots/{robot_id}/events"
    wrong = _create(client, path, {"at": "2026-01-15T09:30:00Z", "note": "Greased"})
    _create(client, path, {"at": "2026-01-16T09:30:00Z", "note": "Belt of joint 5 replaced"})
    _done(client.delete(f"{path}/{wrong}"), *_listed(client, path))


def _webhooks(client: Any) -> None:
    """Make a webhook, test it, look at its journal, and delete it."""
    made = {"name": "MES", "url": "http://127.0.0.1:9/hook", "types": ["report.ready", "robot.alarm"]}
    path = f"/v1/webhooks/{_create(client, '/v1/webhooks', made)}"
    _done(*_listed(client, "/v1/webhooks"), client.get(path))
    delivery = client.post(f"{path}/test")
    _done(delivery)
    address = f"{path}/deliveries"
    wait_until(
        lambda: client.get(address).json()["items"][0]["last_failure"] is not None, 30.0, "an attempt is made"
    )
    _done(
        *_listed(client, address),
        client.post(f"{address}/{delivery.json()['id']}/redeliver"),
        client.delete(path),
    )


def refusals(api: Api) -> None:
    """Make one refusal of each status that the document has, but 429, 503 and 507."""
    client, target_id = api.client, api.make_target()
    api.make_session(target_id)
    read = api.key("read")
    sent = {"name": "board", "kind": "chessboard", "columns": 9, "rows": 6, "pitch_mm": -25.0}
    for response, status in (
        (client.get("/v1/targets", headers={"Authorization": "Bearer gp_unknown"}), 401),
        (client.post("/v1/targets", json=sent, headers=read), 403),
        (client.get("/v1/targets/tgt_unknown"), 404),
        (client.delete(f"/v1/targets/{target_id}"), 409),
        (
            client.post(
                "/v1/targets", content=b" " * (2 << 20), headers={"Content-Type": "application/json"}
            ),
            413,
        ),
        (client.post("/v1/targets", content=b"name: board", headers={"Content-Type": "text/yaml"}), 415),
        (client.post("/v1/targets", json=sent), 422),
    ):
        assert response.status_code == status, response.text


def ask_for_nothing(api: Api, operations: Iterable[Operation]) -> None:
    """Name what there is not in the path of each operation (404), and a parameter that there is not elsewhere (422)."""
    for operation in operations:
        if operation.content.get("security") == []:
            continue
        names = re.findall(r"\{(\w+)\}", operation.path)
        path = operation.path.format(**{name: _UNKNOWN.get(name, f"{name[:3]}_unknown") for name in names})
        asked = {} if names else {"colour": "red"}
        response = api.client.request(operation.method, path, params=asked)
        # What is sent to a key is looked at before the key.
        expected = (404, 415) if names == ["key_id"] else (404,) if names else (422,)
        assert response.status_code in expected, f"{operation.operation_id}: {response.text}"


def over_quota(api: Api, image: bytes) -> None:
    """Send more than a key may (429)."""
    session_id = api.make_session()
    headers = {**OCTETS, **api.key("upload", bytes_per_day=10)}
    response = api.client.put(image_address(session_id, image), content=image, headers=headers)
    assert response.status_code == 429, response.text


def _images(client: Any, session_id: str) -> None:
    session, taken = f"/v1/sessions/{session_id}", take_images(POSES, repeated=REPEATED, cycles=CYCLES)
    commanded = {image.pose_id: image.commanded for image in taken}
    first, *_, last = taken
    _done(client.put(f"{session}/poses/P1", json=commanded["P1"]))  # 201
    _done(client.put(f"{session}/poses/P1", json=commanded["P1"]))  # 200
    _done(
        client.post(
            f"{session}/poses", json=[{"pose_id": pose_id, **pose} for pose_id, pose in commanded.items()]
        ),
        client.post(f"{session}/poses", content=_COMMANDED_CSV, headers={"Content-Type": "text/csv"}),
        client.put(f"{session}/poses/P1", json=commanded["P1"]),
        client.get(f"{session}/poses/P1"),
        *_listed(client, f"{session}/poses"),
    )
    names = [{"pose_id": image.pose_id, "sha256": image.sha256} for image in taken]
    _done(client.post(f"{session}/images/missing", json={"images": names}))
    for image in taken[:-1]:
        address = image_address(session_id, image.data, image.pose_id)
        query = {"cycle": image.cycle, "filename": image.filename}
        _done(client.put(address, content=image.data, params=query, headers=OCTETS))
    form = {"pose_id": last.pose_id, "cycle": str(last.cycle), "captured_at": "2026-01-31T12:00:00Z"}
    file = {"image": (last.filename, last.data, "image/png")}
    for _ in range(2):  # 202, then 200
        _done(client.post(f"{session}/images", data=form, files=file))
    _wait(client, session_id)
    again = image_address(session_id, first.data, first.pose_id)
    _done(client.put(again, content=first.data, headers=OCTETS))  # 200
    items = _done(client.get(f"{session}/measurements")).json()["items"]
    measurement = f"/v1/measurements/{items[0]['id']}"
    _done(client.post(f"{session}/reprocess", json={"only": "all"}))
    _wait(client, session_id)
    _done(client.post(f"{measurement}/retry"))
    _wait(client, session_id)
    _done(
        client.get(measurement, params={"include": "points"}),
        client.patch(
            f"/v1/measurements/{items[CYCLES - 1]['id']}",
            json={"excluded": {"reason": "A hand in front of the board."}},
        ),
        client.patch(session, json={"name": "Cell 4, week 12"}),
        client.get(session),
        *_listed(client, "/v1/sessions"),
        *_listed(client, f"{session}/measurements"),
        client.get(f"{measurement}/image"),
        client.get(f"{measurement}/overlay"),
        client.get(f"{measurement}/thumbnail"),
    )


def _analyses(client: Any, session_id: str) -> None:
    length = {"from_pose_id": "P1", "to_pose_id": "P2", "length_mm": 428.1, "standard_uncertainty_mm": 0.01}
    asked = {"lengths": [length], "maximum_permissible_error_mm": 0.5}
    qualification = f"/v1/sessions/{session_id}/qualification"
    _done(*(client.post(qualification, json=asked, headers=form) for form in (_CSV, {})))
    recorded = _create(client, f"/v1/sessions/{session_id}/qualifications", {**asked, "camera_name": "B-204"})
    _done(client.get(f"/v1/qualifications/{recorded}"), *_listed(client, "/v1/qualifications"))
    poses = client.get(f"/v1/sessions/{session_id}/poses").json()["items"]
    candidates = [
        {"joint_angles_deg": pose["joint_angles_deg"]} for pose in poses if pose["joint_angles_deg"]
    ]
    views, next_view = (
        {"purpose": "hand_eye", "count": 2, "candidates": candidates},
        f"/v1/sessions/{session_id}/next-view",
    )
    _done(*(client.post(next_view, json=views, headers=form) for form in (_CSV, {})))
    for analysis in ("intrinsics", "repeatability", "camera-poses", "hand-eye", "comparison"):
        _done(client.get(f"/v1/sessions/{session_id}/{analysis}", headers=_CSV))
    for analysis in (
        *("intrinsics", "repeatability", "camera-poses", "hand-eye", "comparison"),
        *("repeatability/scatter.svg", "repeatability/drift.svg", "repeatability/steadiness.svg"),
        *("intrinsics/residuals.svg", "intrinsics/projection-uncertainty.svg"),
    ):
        _done(client.get(f"/v1/sessions/{session_id}/{analysis}"))
    for kind in ("ros", "mrcal"):
        _done(client.get(f"/v1/sessions/{session_id}/intrinsics/export", params={"format": kind}))


def _tracker(client: Any, robot_id: str, target_id: str) -> None:
    """Identify the robot from what a laser tracker measured."""
    body = {"name": "Laser tracker", "target_ids": [target_id], "robot_id": robot_id}
    session_id = client.post("/v1/sessions", json=body).json()["id"]
    _, poses = measured()
    read = f"/v1/sessions/{session_id}/measured-poses"
    _done(
        client.post(read, json=readings(poses)),
        *_listed(client, read),
        client.get(f"/v1/sessions/{session_id}/dh", params={"source": "measured_poses"}),
        client.get(f"/v1/sessions/{session_id}/dh", params={"source": "measured_poses"}, headers=_CSV),
        client.get(f"/v1/sessions/{session_id}/dh/error-map", params={"source": "measured_poses"}),
        client.get(
            f"/v1/sessions/{session_id}/dh/error-map", params={"source": "measured_poses"}, headers=_CSV
        ),
        *_compensation(client, robot_id, session_id),
        client.post(read, content=_MEASURED_CSV, headers={"Content-Type": "text/csv"}),
        client.delete(read, params={"pose_id": poses.label(0)}),
    )


def _joint_noise(client: Any, robot_id: str, target_id: str) -> None:
    """Predict repeatability from what a laser tracker measured of repeated poses."""
    body = {"name": "Ten poses, eight visits", "target_ids": [target_id], "robot_id": robot_id}
    path = f"/v1/sessions/{client.post('/v1/sessions', json=body).json()['id']}"
    visits = 8
    _, poses, _ = repeated_poses(21, poses=10, visits=visits)
    rows = [{**row, "cycle": i % visits + 1} for i, row in enumerate(readings(poses))]
    asked = {"source": "measured_poses", "at": ",".join(map(str, np.degrees(KR5_ARC_HOME).round(3).tolist()))}
    noise = f"{path}/joint-noise"
    _done(
        client.post(f"{path}/measured-poses", json=rows),
        client.get(noise, params=asked),
        client.get(noise, params=asked, headers=_CSV),
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
    return [client.post(path, json=commands), client.post(path, json=commands, headers=_CSV)]


def _reports(client: Any, session_id: str) -> None:
    """Order a report, wait until it is made, fetch each form, and verify it."""
    body = {
        "kind": "repeatability",
        "title": "Acceptance of KR 5 arc, cell 4",
        "signatories": [{"name": "R. Meier", "role": "operator"}],
    }
    path = f"/v1/sessions/{session_id}/reports"
    report = _made(client, _done(client.post(path, json=body)).json())
    _done(*_listed(client, path), *_listed(client, "/v1/reports"), client.get(f"{report}/verify"))
    _done(*(client.get(f"{report}.{form}") for form in ("json", "html", "pdf", "csv", "xml", "sig")))


def _history(client: Any, robot_id: str, target_id: str) -> None:
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
        _done(client.post(f"{path}/measured-poses", json=rows))
        made.append(
            _made(client, _done(client.post(f"{path}/reports", json={"kind": "repeatability"})).json())
        )
    history, compared = (
        f"/v1/robots/{robot_id}/history",
        f"{made[0]}/comparison/{made[-1].rpartition('/')[2]}",
    )
    _done(*(client.get(path, headers=headers) for path in (history, compared) for headers in (_CSV, {})))
    _done(client.get(f"{history}.svg"))


def _made(client: Any, report: dict[str, Any]) -> str:
    """Return a report's path once it is made."""
    path = f"/v1/reports/{report['id']}"
    deadline = time.monotonic() + _TIMEOUT_S
    while (found := client.get(path).json())["status"] in ("queued", "running"):
        assert time.monotonic() < deadline, "the report is not made"
        time.sleep(0.1)
    assert found["status"] == "succeeded", found["last_failure"]
    return path


def _removals(client: Any) -> None:
    """Follow a session, to which an image is sent, until it is deleted, and delete all that can be."""
    robot = {"name": "spare", "joints": rows_of(KR5_ARC)}
    target = {"name": "spare", "kind": "circles", "columns": 7, "rows": 5, "pitch_mm": 20.0}
    robot_id, target_id = (
        client.post(path, json=body).json()["id"]
        for path, body in (("/v1/robots", robot), ("/v1/targets", target))
    )
    spare = client.post("/v1/sessions", json={"name": "spare", "target_ids": [target_id]}).json()["id"]
    with ThreadPoolExecutor(1) as pool:
        followed = pool.submit(client.get, f"/v1/sessions/{spare}/events")
        time.sleep(1.0)  # a stream of the deleted session would be 404
        image = small_image(2)
        _done(client.put(image_address(spare, image, "P1"), content=image, headers=OCTETS))
        time.sleep(1.0)
        _done(client.delete(f"/v1/sessions/{spare}"))
        _done(followed.result(_TIMEOUT_S))
    _done(client.delete(f"/v1/robots/{robot_id}"), client.delete(f"/v1/targets/{target_id}"))


def _keys(client: Any, session_id: str) -> None:
    key = {
        "name": "Cell 4",
        "scope": "ingest",
        "expires_in_days": 365,
        "session_ids": [session_id],
        "bytes_per_day": 10**9,
    }
    key_id = client.post("/v1/keys", json=key).json()["id"]
    _done(
        client.patch(f"/v1/keys/{key_id}", json={"name": "Cell 4, camera 1"}),
        client.get(f"/v1/keys/{key_id}"),
        *_listed(client, "/v1/keys"),
        client.delete(f"/v1/keys/{key_id}"),
    )


def _listed(client: Any, path: str) -> list[Any]:
    """Ask for a list as JSON, and for its beginning as a table."""
    return [client.get(path), client.get(path, params={"limit": 2}, headers=_CSV)]


def _create(client: Any, path: str, body: dict[str, Any]) -> str:
    return str(_done(client.post(path, json=body)).json()["id"])


def _wait(client: Any, session_id: str) -> None:
    deadline = time.monotonic() + _TIMEOUT_S
    while True:
        counts = _done(client.get(f"/v1/sessions/{session_id}")).json()["counts"]
        if counts["queued"] + counts["running"] == 0:
            assert counts["succeeded"] > 0, counts
            return
        assert time.monotonic() < deadline, counts
        time.sleep(0.1)


def _done(*responses: Any) -> Any:
    """Return the last response; each must be a success."""
    for response in responses:
        assert response.is_success, f"{response.request.url}: {response.text[:500]}"
    return responses[-1]
