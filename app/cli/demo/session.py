"""The demo's sessions: an experiment rendered, described to a service, uploaded, and its answers read."""

from __future__ import annotations

import math
import multiprocessing
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float
from rich.progress import Progress

from app.client import (
    ClientError,
    Json,
    ServiceClient,
    UploadResult,
    collect_results,
    plan_files,
    upload_files,
)
from app.client.commands import transfer
from app.settings import Settings
from app.threads import limit_threads
from core import TargetSpec
from core.geometry import Camera, invert, rotation_to_rpy, so3_exp, transform
from core.kinematics import Chain
from core.simulation import KR5_ARC, Arm, CubePose, Scene, SessionImage, cube_experiment, render

BOARD = TargetSpec("charuco", 14, 10, 21.0, marker_mm=15.0, dictionary="DICT_5X5_100")
CAMERA = Camera(2320.0, 2320.0, 1244.0, 1009.0, k1=-0.1, k2=0.05)  # off-centre, as real lenses are
SIZE_PX = (2448, 2050)
CYCLES, QUICK_CYCLES = 20, 10
SMALL_POSES = ("P1", "P2", "P3")
FLAT = "flat"
_FLAT_TILT = math.radians(0.3)
_ANALYSES: tuple[tuple[str, dict[str, str]], ...] = (
    ("repeatability", {}),
    ("repeatability", {"estimator": "per_image_fixed_pp"}),
    ("comparison", {}),
)
_PLOTS = {
    "scatter.svg": "repeatability/scatter.svg",
    "drift.svg": "repeatability/drift.svg",
    "residuals.svg": "intrinsics/residuals.svg",
}


@dataclass(frozen=True, slots=True)
class DemoSession:
    """The arm, the poses with their truth, and the images: the experiment's, then one view that is nearly flat."""

    arm: Arm
    poses: tuple[CubePose, ...]
    images: tuple[SessionImage, ...]
    cycles: int
    size_px: tuple[int, int]


@dataclass(frozen=True, slots=True)
class Answers:
    """What the service answered."""

    session_id: str
    measurements: list[Json]
    repeatability: Json


@dataclass(frozen=True, slots=True)
class PaperAnswers(Answers):
    """The same for the whole experiment.

    `fixed_centre` is the repeatability with every image calibrated by itself and the principal point fixed, as the
    paper's Table III seems to have been made.
    """

    fixed_centre: Json
    comparison: Json


def demo_session(seed: int, *, quick: bool = False) -> DemoSession:
    """Return what is to be photographed; `quick`: half as wide and high, and half as many cycles."""
    camera, size, cycles = CAMERA, SIZE_PX, CYCLES
    if quick:
        size, cycles = (SIZE_PX[0] // 2, SIZE_PX[1] // 2), QUICK_CYCLES
        centre = (CAMERA.cx_px / 2.0 - 0.25, CAMERA.cy_px / 2.0 - 0.25)
        camera = replace(
            CAMERA, fx_px=CAMERA.fx_px / 2.0, fy_px=CAMERA.fy_px / 2.0, cx_px=centre[0], cy_px=centre[1]
        )
    experiment = cube_experiment(BOARD, camera, size, cycles=cycles, seed=seed)
    first = experiment.images[0]
    distance_mm = float(np.linalg.norm(first.commanded_T_target_camera[:3, 3]))
    rotation = so3_exp(np.array([_FLAT_TILT, 0.0, 0.0]))
    middle = BOARD.points_target().mean(axis=0)
    T_camera_target = transform(rotation, np.array([0.0, 0.0, distance_mm]) - rotation @ middle)
    flat = SessionImage(
        FLAT, 1, invert(T_camera_target), replace(first.scene, T_camera_target=T_camera_target, seed=seed)
    )
    return DemoSession(experiment.arm, experiment.poses, (*experiment.images, flat), cycles, size)


def small_session(seed: int) -> DemoSession:
    """Return the quick experiment's first poses and its flat view."""
    session = demo_session(seed, quick=True)
    return replace(
        session,
        poses=tuple(pose for pose in session.poses if pose.pose_id in SMALL_POSES),
        images=tuple(image for image in session.images if image.pose_id in (*SMALL_POSES, FLAT)),
    )


def image_files(images: Sequence[SessionImage], folder: Path) -> dict[Path, Scene]:
    """Return where each image's file goes, folder/pose/c{cycle}.png, with what it shows."""
    return {folder / image.pose_id / f"c{image.cycle}.png": image.scene for image in images}


def render_images(
    files: Mapping[Path, Scene], progress: Progress, on_first: Callable[[Path], None] = lambda path: None
) -> None:
    """Render into files, in as many processes as there are cores to use; `on_first` gets the first that is there."""
    task = progress.add_task("rendering", total=len(files))
    limit_threads()  # inherited: each process is to keep to one core
    with ProcessPoolExecutor(
        min(max(Settings().worker_count, 1), 16),  # each holds an image of 100 MB
        mp_context=multiprocessing.get_context("spawn"),
        initializer=cv2.setNumThreads,
        initargs=(1,),
    ) as processes:
        jobs = []
        for path, scene in files.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            jobs.append(processes.submit(_render, scene, path))
        for done, job in enumerate(as_completed(jobs)):
            path = job.result()
            progress.advance(task)
            if done == 0:
                on_first(path)


def _render(scene: Scene, path: Path) -> Path:
    written, data = cv2.imencode(".png", render(scene))
    assert written
    part = path.with_suffix(".part")  # no image before it is whole
    part.write_bytes(data.tobytes())
    return part.replace(path)


def measure_image(client: ServiceClient, session_id: str, path: Path, folder: Path) -> Json:
    """Upload one image of the folder and return its measurement."""
    file = next(file for file in plan_files(folder / "images").images if file.path == path)
    return collect_results(client, session_id, upload_files(client, session_id, [file])).measurements[0]


def upload_session(client: ServiceClient, session_id: str, folder: Path, progress: Progress) -> list[Json]:
    """Do what a shop-floor PC does: upload the images, and wait for the results.

    Returns the measurements. Raises ClientError where the service does not accept an image.
    """
    outcomes, result = transfer(client, session_id, plan_files(folder / "images").images, progress, wait=True)
    assert result is not None
    require_sent(outcomes)
    return list(result.measurements)


def require_sent(outcomes: Sequence[UploadResult]) -> None:
    """Raise ClientError with the first image that the service did not accept."""
    for outcome in outcomes:
        if outcome.status == "failed":
            raise ClientError("upload_failed", f"{outcome.name}: {outcome.reason}", outcome.advice)


def run_session(
    client: ServiceClient, session: DemoSession, robot_id: str, folder: Path, progress: Progress
) -> PaperAnswers:
    """Upload the session and read all analyses of the paper; keep plots and overlays in the folder."""
    session_id = describe_session(client, session, robot_id)
    measurements = upload_session(client, session_id, folder, progress)
    analysing = progress.add_task("analysing", total=len(_ANALYSES) + len(_PLOTS))
    answers = []
    for analysis, query in _ANALYSES:
        answers.append(client.get(f"/v1/sessions/{session_id}/{analysis}", **query))
        progress.advance(analysing)
    for name, plot in _PLOTS.items():
        (folder / name).write_bytes(client.get_bytes(f"/v1/sessions/{session_id}/{plot}"))
        progress.advance(analysing)
    for measurement in measurements:
        if measurement["status"] == "succeeded" and measurement["cycle"] == 1:
            overlay = client.get_bytes(f"/v1/measurements/{measurement['id']}/overlay")
            (folder / f"overlay-{measurement['pose_id']}.png").write_bytes(overlay)
    return PaperAnswers(session_id, measurements, *answers)


def describe_robot(client: ServiceClient) -> str:
    """Create the robot with its data sheet's parameters; return its id."""
    return str(client.create("/v1/robots", {"name": "KUKA KR5 Arc", "joints": joint_rows(KR5_ARC)})["id"])


def describe_session(client: ServiceClient, session: DemoSession, robot_id: str) -> str:
    """Create board, session and poses; return the session's id."""
    target_id = client.create(
        "/v1/targets",
        {
            "name": f"ChArUco {BOARD.columns} × {BOARD.rows}",
            "kind": BOARD.kind,
            "columns": BOARD.columns,
            "rows": BOARD.rows,
            "pitch_mm": BOARD.pitch_mm,
            "marker_mm": BOARD.marker_mm,
            "dictionary": BOARD.dictionary,
        },
    )["id"]
    body = {"name": "Demo", "target_ids": [target_id], "robot_id": robot_id}
    session_id: str = client.create("/v1/sessions", body)["id"]
    for pose in session.poses:
        path = f"/v1/sessions/{session_id}/poses/{pose.pose_id}"
        angles = np.degrees(pose.joint_angles).tolist()
        client.put(path, {**_pose_body(pose.commanded_T_base_flange), "joint_angles_deg": angles})
    return session_id


def joint_rows(chain: Chain) -> list[Json]:
    """Return a robot's joints as `POST /v1/robots` takes them."""
    return [
        {
            "a_mm": joint.a_mm,
            "alpha_deg": math.degrees(joint.alpha_rad),
            "d_mm": joint.d_mm,
            "theta_offset_deg": math.degrees(joint.theta_offset_rad),
        }
        for joint in chain.joints
    ]


def _pose_body(T_base_flange: Float[np.ndarray, "4 4"]) -> Json:
    roll, pitch, yaw = np.degrees(rotation_to_rpy(T_base_flange[:3, :3])).tolist()
    position_mm = T_base_flange[:3, 3].tolist()
    return {"position_mm": position_mm, "roll_deg": roll, "pitch_deg": pitch, "yaw_deg": yaw}
