"""One small robot cell from its first target to its last key, through the real application: each operation once.

A KUKA KR5 with a camera on its flange returns ten times to two poses and once to six others before a chessboard; a
laser tracker follows it through sweeps of its joints. Images are rendered and measured by a worker process.
"""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from app.cli.demo.session import joint_rows
from core.simulation import KR5_ARC, KR5_ARC_HOME, T_FLANGE_CAMERA
from tests.support.contract.cell import CAMERA, SIZE_PX, TARGET, take_images
from tests.support.contract.requests import CSV, TIMEOUT_S, create, done, listed, report_made, wait
from tests.support.contract.tracker_story import history, joint_noise, tracker
from tests.support.image.images import small_image
from tests.support.service.service import OCTETS, Api, image_address, wait_until

POSES, REPEATED, CYCLES = 8, 2, 10
_COMMANDED_CSV = """\
pose_id,position_x_mm,position_y_mm,position_z_mm,roll_deg,pitch_deg,yaw_deg
P1,907.414705,88.985509,838.684919,158.296313,28.925181,73.836431
P9,850.0,0.0,700.0,180.0,0.0,0.0
"""


def use_every_operation(api: Api) -> None:
    """Go through every operation that succeeds; the last answer of each is the one that reads best."""
    client = api.client
    robot_id = create(
        client,
        "/v1/robots",
        {
            "name": "KR 5 arc, cell 4",
            "joints": joint_rows(KR5_ARC),
            "manufacturer": "KUKA",
            "model": "KR 5 arc",
            "datasheet_repeatability_mm": 0.1,
        },
    )
    done(client.patch(f"/v1/robots/{robot_id}", json={"serial_number": "412", "datasheet_accuracy_mm": 0.6}))
    _events(client, robot_id)
    target_id = create(client, "/v1/targets", TARGET)
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
    done(client.patch(f"/v1/targets/{target_id}", json=known))
    session_id = create(
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
        done(client.get(f"/v1/{kind}/{row_id}"), *listed(client, f"/v1/{kind}"))
    history(client, robot_id, target_id)  # first: later answers of the same operations read better
    _removals(api)
    _images(client, session_id)
    _analyses(client, session_id)
    tracker(client, robot_id, target_id)
    joint_noise(client, robot_id, target_id)
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
    done(*(client.post(f"/v1/robots/{robot_id}/dh-plan", json=plan, headers=form) for form in (CSV, {})))
    _reports(client, session_id)
    _webhooks(client)
    _keys(client, session_id)
    done(*listed(client, "/v1/audit"), *(client.get(path) for path in ("/livez", "/readyz", "/metrics")))


def _events(client: Any, robot_id: str) -> None:
    """Note what was done to a robot, and delete what was noted in error."""
    path = f"/v1/robots/{robot_id}/events"
    wrong = create(client, path, {"at": "2026-01-15T09:30:00Z", "note": "Greased"})
    create(client, path, {"at": "2026-01-16T09:30:00Z", "note": "Belt of joint 5 replaced"})
    done(client.delete(f"{path}/{wrong}"), *listed(client, path))


def _webhooks(client: Any) -> None:
    """Make a webhook, test it, look at its journal, and delete it."""
    made = {"name": "MES", "url": "http://127.0.0.1:9/hook", "types": ["report.ready", "robot.alarm"]}
    path = f"/v1/webhooks/{create(client, '/v1/webhooks', made)}"
    done(*listed(client, "/v1/webhooks"), client.get(path))
    delivery = client.post(f"{path}/test")
    done(delivery)
    address = f"{path}/deliveries"
    wait_until(
        lambda: client.get(address).json()["items"][0]["last_failure"] is not None,
        120.0,
        "an attempt is made",
    )
    done(
        *listed(client, address),
        client.post(f"{address}/{delivery.json()['id']}/redeliver"),
        client.delete(path),
    )


def _images(client: Any, session_id: str) -> None:
    session, taken = f"/v1/sessions/{session_id}", take_images(POSES, repeated=REPEATED, cycles=CYCLES)
    commanded = {image.pose_id: image.commanded for image in taken}
    first, *_, last = taken
    done(client.put(f"{session}/poses/P1", json=commanded["P1"]))  # 201
    done(client.put(f"{session}/poses/P1", json=commanded["P1"]))  # 200
    done(
        client.post(
            f"{session}/poses", json=[{"pose_id": pose_id, **pose} for pose_id, pose in commanded.items()]
        ),
        client.post(f"{session}/poses", content=_COMMANDED_CSV, headers={"Content-Type": "text/csv"}),
        client.put(f"{session}/poses/P1", json=commanded["P1"]),
        client.get(f"{session}/poses/P1"),
        *listed(client, f"{session}/poses"),
    )
    names = [{"pose_id": image.pose_id, "sha256": image.sha256} for image in taken]
    done(client.post(f"{session}/images/missing", json={"images": names}))
    for image in taken[:-1]:
        address = image_address(session_id, image.data, image.pose_id)
        query = {"cycle": image.cycle, "filename": image.filename}
        done(client.put(address, content=image.data, params=query, headers=OCTETS))
    form = {"pose_id": last.pose_id, "cycle": str(last.cycle), "captured_at": "2026-01-31T12:00:00Z"}
    file = {"image": (last.filename, last.data, "image/png")}
    for _ in range(2):  # 202, then 200
        done(client.post(f"{session}/images", data=form, files=file))
    wait(client, session_id)
    again = image_address(session_id, first.data, first.pose_id)
    done(client.put(again, content=first.data, headers=OCTETS))  # 200
    items = done(client.get(f"{session}/measurements")).json()["items"]
    measurement = f"/v1/measurements/{items[0]['id']}"
    done(client.post(f"{session}/reprocess", json={"only": "all"}))
    wait(client, session_id)
    done(client.post(f"{measurement}/retry"))
    wait(client, session_id)
    done(
        client.get(measurement, params={"include": "points"}),
        client.patch(
            f"/v1/measurements/{items[CYCLES - 1]['id']}",
            json={"excluded": {"reason": "A hand in front of the board."}},
        ),
        client.patch(session, json={"name": "Cell 4, week 12"}),
        client.get(session),
        *listed(client, "/v1/sessions"),
        *listed(client, f"{session}/measurements"),
        client.get(f"{measurement}/image"),
        client.get(f"{measurement}/overlay"),
        client.get(f"{measurement}/thumbnail"),
    )


def _analyses(client: Any, session_id: str) -> None:
    length = {"from_pose_id": "P1", "to_pose_id": "P2", "length_mm": 428.1, "standard_uncertainty_mm": 0.01}
    asked = {"lengths": [length], "maximum_permissible_error_mm": 0.5}
    qualification = f"/v1/sessions/{session_id}/qualification"
    done(*(client.post(qualification, json=asked, headers=form) for form in (CSV, {})))
    recorded = create(client, f"/v1/sessions/{session_id}/qualifications", {**asked, "camera_name": "B-204"})
    done(client.get(f"/v1/qualifications/{recorded}"), *listed(client, "/v1/qualifications"))
    poses = client.get(f"/v1/sessions/{session_id}/poses").json()["items"]
    candidates = [
        {"joint_angles_deg": pose["joint_angles_deg"]} for pose in poses if pose["joint_angles_deg"]
    ]
    views, next_view = (
        {"purpose": "hand_eye", "count": 2, "candidates": candidates},
        f"/v1/sessions/{session_id}/next-view",
    )
    done(*(client.post(next_view, json=views, headers=form) for form in (CSV, {})))
    for analysis in ("intrinsics", "repeatability", "camera-poses", "hand-eye", "comparison"):
        done(client.get(f"/v1/sessions/{session_id}/{analysis}", headers=CSV))
    for analysis in (
        *("intrinsics", "repeatability", "camera-poses", "hand-eye", "comparison"),
        *("repeatability/scatter.svg", "repeatability/drift.svg", "repeatability/steadiness.svg"),
        *("intrinsics/residuals.svg", "intrinsics/projection-uncertainty.svg"),
    ):
        done(client.get(f"/v1/sessions/{session_id}/{analysis}"))
    for kind in ("ros", "mrcal"):
        done(client.get(f"/v1/sessions/{session_id}/intrinsics/export", params={"format": kind}))


def _reports(client: Any, session_id: str) -> None:
    """Order a report, wait until it is made, fetch each form, and verify it."""
    body = {
        "kind": "repeatability",
        "title": "Acceptance of KR 5 arc, cell 4",
        "signatories": [{"name": "R. Meier", "role": "operator"}],
    }
    path = f"/v1/sessions/{session_id}/reports"
    report = report_made(client, done(client.post(path, json=body)).json())
    done(*listed(client, path), *listed(client, "/v1/reports"), client.get(f"{report}/verify"))
    done(*(client.get(f"{report}.{form}") for form in ("json", "html", "pdf", "csv", "xml", "sig")))


def _removals(api: Api) -> None:
    """Follow a session, to which an image is sent, until it is deleted, and delete all that can be."""
    client = api.client
    robot = {"name": "spare", "joints": joint_rows(KR5_ARC)}
    target = {"name": "spare", "kind": "circles", "columns": 7, "rows": 5, "pitch_mm": 20.0}
    robot_id, target_id = (
        client.post(path, json=body).json()["id"]
        for path, body in (("/v1/robots", robot), ("/v1/targets", target))
    )
    spare = client.post("/v1/sessions", json={"name": "spare", "target_ids": [target_id]}).json()["id"]
    with ThreadPoolExecutor(1) as pool:
        followed = pool.submit(client.get, f"/v1/sessions/{spare}/events")
        # A stream of the deleted session would be 404.
        wait_until(lambda: api.service.streams.count() == 1, what="the session is followed")
        image = small_image(2)
        done(client.put(image_address(spare, image, "P1"), content=image, headers=OCTETS))
        time.sleep(1.0)
        done(client.delete(f"/v1/sessions/{spare}"))
        done(followed.result(TIMEOUT_S))
    done(client.delete(f"/v1/robots/{robot_id}"), client.delete(f"/v1/targets/{target_id}"))


def _keys(client: Any, session_id: str) -> None:
    key = {
        "name": "Cell 4",
        "scope": "ingest",
        "expires_in_days": 365,
        "session_ids": [session_id],
        "bytes_per_day": 10**9,
    }
    key_id = client.post("/v1/keys", json=key).json()["id"]
    done(
        client.patch(f"/v1/keys/{key_id}", json={"name": "Cell 4, camera 1"}),
        client.get(f"/v1/keys/{key_id}"),
        *listed(client, "/v1/keys"),
        client.delete(f"/v1/keys/{key_id}"),
    )
