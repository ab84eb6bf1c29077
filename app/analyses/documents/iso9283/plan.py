"""The plan of a test by ISO 9283: its poses, under what conditions they are visited, and what the session will show."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from app.analyses.documents.iso9283.runs import Json, PlanRefused, approach_poses, runs
from core import TargetSpec
from core.geometry import Camera, invert, rotation_to_rpy, rpy_to_rotation, so3_exp, transform
from core.metrology import CYCLES, MAX_INSTRUMENT_SHARE, TEST_PLANES, VISITS, TestCube
from core.simulation import Forecast, PlannedSession, forecast_repeatability

Three = tuple[float, float, float]
_ADDITIONAL_TILT = math.radians(25.0)
_ADDITIONAL = {"T1": (1.0, 0.0), "T2": (-1.0, 0.0), "T3": (0.0, 1.0), "T4": (0.0, -1.0)}
"""Four views in addition to the cube's, tilted about the camera's x and y axes: they determine lens and print."""
POSE_FIELDS = ("pose_id", "position_mm", "roll_deg", "pitch_deg", "yaw_deg")


@dataclass(frozen=True, slots=True, kw_only=True)
class TestRequest:
    """What is asked of a test: cube (mm, base frame), camera, where the target stands, and the conditions.

    `orientation_deg` are roll, pitch and yaw of the flange at all poses, `tilt_deg` that of the target against the
    image plane. Empty loads and speeds are one run of neither.
    """

    __test__ = False  # no test of pytest's

    centre_mm: Three
    side_mm: float
    focal_px: float
    size_px: tuple[int, int]
    orientation_deg: Three = (180.0, 0.0, 0.0)
    plane: str = next(iter(TEST_PLANES))
    distance_mm: float = 700.0
    tilt_deg: float = 20.0
    cycles: int = CYCLES
    images_per_stop: int = 1
    corner_sigma_px: float = 0.02
    rp_mm: float = 0.05
    limit_mm: float | None = None
    loads_kg: tuple[float, ...] = ()
    speeds_percent: tuple[float, ...] = ()
    approaches: int = 1
    approach_mm: float = 50.0
    warm_up_min: float | None = None


def plan_test(spec: TargetSpec, asked: TestRequest) -> Json:
    """Return the plan as a document: poses, forecast of floor, intervals and verdicts, runs, and the count of images.

    `least_rp_l_mm` is from which RP_l on the verdict is `robot` at all poses; None where one does not see the target.

    Raises PlanRefused and other GridposeErrors for what cannot be planned.
    """
    if not (0.0 < asked.distance_mm < 1e6 and abs(asked.tilt_deg) < 80.0):
        raise PlanRefused("The distance must be larger than 0 mm, the tilt below 80°.")
    cube = TestCube(asked.centre_mm, asked.side_mm, asked.plane)
    R_base_flange = rpy_to_rotation(np.radians(asked.orientation_deg))
    width, height = asked.size_px
    focal = asked.focal_px
    camera = Camera(focal, focal, 0.5 * (width - 1), 0.5 * (height - 1), 0.0, 0.0, 0.0, 0.0)
    flange, additional = _flange_poses(cube, R_base_flange, asked.distance_mm)
    middle = spec.points_target().mean(axis=0)
    stands = so3_exp(np.array([math.radians(asked.tilt_deg), 0.0, 0.0]))
    ahead = np.array([0.0, 0.0, asked.distance_mm])
    T_base_target = flange[0] @ transform(stands, ahead - stands @ middle)
    planned = PlannedSession(
        spec,
        camera,
        (width, height),
        np.array([invert(T) @ T_base_target for T in flange]),
        np.array([invert(T) @ T_base_target for T in additional]),
        asked.cycles,
        asked.corner_sigma_px,
        asked.images_per_stop,
    )
    forecast = forecast_repeatability(planned, asked.rp_mm, limit_mm=asked.limit_mm)
    plan = _document(cube, flange, additional, planned, forecast, asked.rp_mm, asked.limit_mm)
    of_approach = approach_poses(plan["poses"], asked.approaches, asked.approach_mm)
    conditions = runs(asked.loads_kg, asked.speeds_percent)
    of_cycles = asked.cycles * asked.images_per_stop * (len(flange) + len(of_approach))
    floors = [one.floor_mm for one in forecast.poses if one.in_view]
    return plan | {
        "least_rp_l_mm": max(floors) / MAX_INSTRUMENT_SHARE if len(floors) == len(flange) else None,
        "warm_up_min": asked.warm_up_min,
        "runs": conditions,
        "approach_poses": of_approach,
        "images": len(conditions) * (of_cycles + len(additional)),
    }


def _flange_poses(
    cube: TestCube, R_base_flange: Float[np.ndarray, "3 3"], distance_mm: float
) -> tuple[Float[np.ndarray, "5 4 4"], Float[np.ndarray, "4 4 4"]]:
    """Return T_base_flange of P1 to P5, and of the additional views, turned about the point before the camera at P1."""
    poses = np.array([transform(R_base_flange, p) for p in cube.positions_mm])
    ahead = np.array([0.0, 0.0, distance_mm])
    additional = []
    for about_x, about_y in _ADDITIONAL.values():
        R = so3_exp(_ADDITIONAL_TILT * np.array([about_x, about_y, 0.0]))
        additional.append(poses[0] @ transform(R, ahead - R @ ahead))
    return poses, np.array(additional)


def _document(
    cube: TestCube,
    flange: Float[np.ndarray, "5 4 4"],
    additional: Float[np.ndarray, "4 4 4"],
    planned: PlannedSession,
    forecast: Forecast,
    rp_mm: float,
    limit_mm: float | None,
) -> Json:
    names = [f"P{k + 1}" for k in range(len(flange))]
    return {
        "standard": "ISO 9283:1998",
        "cube": {
            "centre_mm": list(cube.centre_mm),
            "side_mm": cube.side_mm,
            "plane": cube.plane,
            "corners_mm": {f"C{k + 1}": corner for k, corner in enumerate(cube.corners_mm.tolist())},
        },
        "poses": [_pose(name, T) for name, T in zip(names, flange, strict=True)],
        "additional_poses": [_pose(name, T) for name, T in zip(_ADDITIONAL, additional, strict=True)],
        "cycles": planned.cycles,
        "order_of_a_cycle": list(VISITS),
        "images_per_stop": planned.images_per_stop,
        "assumed": {
            "rp_l_mm": rp_mm,
            "corner_sigma_px": planned.corner_sigma_px,
            "focal_px": planned.camera.fx_px,
            "image_px": list(planned.size_px),
        },
        "forecast": [
            {
                "pose_id": name,
                "in_view": one.in_view,
                "noise_floor_mm": one.floor_mm if one.in_view else None,
                "rp_l_mm": one.reading_mm if one.in_view else None,
                "interval_mm": list(one.interval_mm) if one.in_view else None,
                "verdicts": dict(one.verdicts),
            }
            for name, one in zip(names, forecast.poses, strict=True)
        ],
        "acceptance": None
        if forecast.decisions is None
        else {"datasheet_repeatability_mm": limit_mm, **forecast.decisions},
    }


def _pose(name: str, T: Float[np.ndarray, "4 4"]) -> dict[str, Any]:
    angles = np.degrees(rotation_to_rpy(T[:3, :3])).round(6) + 0.0
    return dict(zip(POSE_FIELDS, (name, (T[:3, 3].round(6) + 0.0).tolist(), *angles.tolist()), strict=True))
