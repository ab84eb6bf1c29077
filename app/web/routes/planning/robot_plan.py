"""The plan of a robot's identification: what given poses would determine, and what further ones would gain."""

from __future__ import annotations

import json
import math
from typing import Annotated, Any

from fastapi import Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from app.errors import Conflict, InvalidContent
from app.http import get_requester, run_while_connected
from app.records.numbers import DH_PARAMETERS
from app.records.tables import Robot, Target
from app.services.queries import get_or_raise
from app.services.robots import read_plan
from app.web.pages import page_router, render
from app.web.robot_parameters import PARAMETER_NAMES
from app.web.routes.planning.session_advice import known_targets, require_computing
from app.web.service import Service, service_of

router = page_router()
_MAX_ANGLE_DEG = 36_000.0
Millimetres = Annotated[float, Query(gt=0.0, le=1000.0, allow_inf_nan=False)]


@router.get("/robots/{robot_id}/plan", operation_id="create_dh_plan")
async def show_robot_plan(
    request: Request,
    robot_id: str,
    target: Annotated[str, Query(max_length=64)] = "",
    home: Annotated[str, Query(max_length=400)] = "",
    focal_length_mm: Millimetres = 8.0,
    pixel_pitch_um: Millimetres = 3.45,
    width: Annotated[int, Query(ge=16, le=65_535)] = 2448,
    height: Annotated[int, Query(ge=16, le=65_535)] = 2050,
    sweep_deg: Annotated[float, Query(gt=0.0, le=180.0, allow_inf_nan=False)] = 12.0,
    steps: Annotated[int, Query(ge=3, le=40)] = 9,
    free: Annotated[int, Query(ge=0, le=200)] = 20,
    suggest: Annotated[int, Query(ge=0, le=20)] = 5,
) -> Response:
    """Ask for home, camera and poses; show each parameter's predicted uncertainty, without and with further poses."""
    require_computing(request)
    service = service_of(request)
    robot, targets = await run_in_threadpool(_read, service, robot_id)
    plan: dict[str, Any] | None = None
    refused: Conflict | InvalidContent | None = None
    if target and home:
        focal_px = 1000.0 * focal_length_mm / pixel_pitch_um
        camera = {
            **{"fx_px": focal_px, "fy_px": focal_px, "cx_px": 0.5 * (width - 1), "cy_px": 0.5 * (height - 1)},
            **dict.fromkeys(("k1", "k2", "p1", "p2", "k3"), 0.0),
            **{"image_width_px": width, "image_height_px": height},
        }
        asked = {
            "camera": camera,
            "sweeps": {"sweep_half_angle_deg": sweep_deg, "steps": steps, "joint_numbers": None},
            "random_poses": free,
            "poses": [],
            "random_half_range_deg": sweep_deg,
            "T_flange_camera": None,
            "image_coverage": 0.5,
            "noise_px": 0.05,
            "robot_position_sigma_mm": 0.0,
            "robot_rotation_sigma_deg": 0.0,
            "suggest_count": suggest,
            "candidate_count": 300,
        }
        try:
            asked["home_deg"] = angles_of(home, len(robot.joints))
            database = service.installation.database
            described, grid = await run_in_threadpool(read_plan, database, robot_id, target)
            answer = service.analyses.plan(described, grid, asked, await get_requester(request))
            plan = json.loads(await run_while_connected(request, answer))
        except (Conflict, InvalidContent) as reason:
            refused = reason
    return render(
        request,
        "planning/robot_plan.html",
        robot=robot,
        targets=targets,
        asked={
            **{"target": target, "home": home, "focal_length_mm": focal_length_mm, "width": width},
            **{"pixel_pitch_um": pixel_pitch_um, "height": height, "sweep_deg": sweep_deg, "steps": steps},
            **{"free": free, "suggest": suggest},
        },
        plan=plan,
        rows=plan_rows(plan) if plan is not None else [],
        refused=refused,
    )


def angles_of(text: str, joints: int) -> list[float]:
    """Return joint angles in degrees that are separated by commas or blanks. Raises InvalidContent."""
    try:
        angles = [float(part) for part in text.replace(",", " ").split()]
    except ValueError:
        angles = []
    if len(angles) != joints or not all(math.isfinite(a) and abs(a) <= _MAX_ANGLE_DEG for a in angles):
        raise InvalidContent(
            f"Home is not {joints} angles.",
            "Write one angle for each joint in degrees, from the base, with commas between.",
            errors=[("home", "is no list of angles")],
        )
    return angles


def plan_rows(plan: dict[str, Any]) -> list[dict[str, Any]]:
    """Return every parameter with its predicted uncertainty, that with the suggested poses, and their ratio."""
    later = plan["predicted_joints_with_suggestions"] or [None] * len(plan["joints"])
    rows = []
    for joint, with_more in zip(plan["joints"], later, strict=True):
        for name in DH_PARAMETERS:
            now = joint["standard_uncertainty"][name]
            then = None if with_more is None else with_more["standard_uncertainty"][name]
            if now is None and then is None:
                continue
            rows.append(
                {
                    "joint": joint["joint"],
                    "name": PARAMETER_NAMES[name],
                    "unit": "mm" if name.endswith("_mm") else "°",
                    "now": now,
                    "then": then,
                    "gain": now / then if now and then else None,
                }
            )
    return rows


def _read(service: Service, robot_id: str) -> tuple[Robot, list[Target]]:
    with service.installation.database.read() as records:
        return get_or_raise(records, Robot, robot_id), known_targets(records)
