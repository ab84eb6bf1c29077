"""Datasets in other programs' layouts: what is sent of them, and what is refused."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.client.commands.record_files import FileRefused
from app.client.commands.sessions.layouts import Dataset, Layout, read_dataset
from core.geometry import invert, so3_exp, transform
from tests.app.cli.test_creation import gridpose
from tests.support.image.images import small_image
from tests.support.service.service import ApiMaker

ROTATION = np.array([0.3, -1.2, 2.0])
POSITION_M = np.array([0.61, -0.2, 0.4])
T_BASE_FLANGE = transform(so3_exp(ROTATION), 1000.0 * POSITION_M)
VISP = "# a pose\nrows: 6\ncols: 1\ndata:\n" + "".join(
    f"  - [{v!r}]\n" for v in (*POSITION_M.tolist(), *ROTATION.tolist())
)


def quaternion() -> list[float]:
    angle = float(np.linalg.norm(ROTATION))
    x, y, z = (math.sin(angle / 2.0) * ROTATION / angle).tolist()
    return [x, y, z, math.cos(angle / 2.0)]


def write(folder: Path, files: dict[str, str | bytes]) -> Path:
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder


def industrial(*, static: bool = False) -> dict[str, str | bytes]:
    names = dict(
        zip(("x", "y", "z", "qx", "qy", "qz", "qw"), [*POSITION_M.tolist(), *quaternion()], strict=True)
    )
    pose = "".join(f"{name}: {value!r}\n" for name, value in names.items())
    views = "".join(f"  - pose: poses/{n}.yaml\n    image: images/{n}.png\n" for n in (0, 1))
    return {
        "cal_data.yaml": f"data:\n{views}static_camera: {str(static).lower()}\n",
        **{f"poses/{n}.yaml": pose for n in (0, 1)},
        **{f"images/{n}.png": small_image(n) for n in (0, 1)},
    }


def samples(count: int = 2) -> str:
    robot = {
        "translation": dict(zip("xyz", POSITION_M.tolist(), strict=True)),
        "rotation": dict(zip("xyzw", quaternion(), strict=True)),
    }
    tracking = {
        "translation": dict.fromkeys("xyz", 0.0),
        "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
    }
    return json.dumps({"samples": [{"robot": robot, "tracking": tracking}] * count})


def matrix(pose: dict[str, Any]) -> Any:
    roll, pitch, yaw = (math.radians(pose[name]) for name in ("roll_deg", "pitch_deg", "yaw_deg"))
    R = so3_exp(np.array([0, 0, yaw])) @ so3_exp(np.array([0, pitch, 0])) @ so3_exp(np.array([roll, 0, 0]))
    return transform(R, np.array(pose["position_mm"]))


def assert_poses(dataset: Dataset, expected: Any) -> None:
    for pose in dataset.poses:
        np.testing.assert_allclose(matrix(pose), expected, atol=1e-9)


@pytest.mark.parametrize("fixed_camera", [False, True])
def test_visp_pairs_images_and_poses_by_number(tmp_path: Path, fixed_camera: bool) -> None:
    files: dict[str, str | bytes] = {f"franka_image-{n}.png": small_image(n) for n in (1, 2, 10)}
    files |= {"franka_pose_fPe_10.yaml": VISP, "franka_pose_fPe_2.yaml": VISP, "franka_pose_rPe_3.yaml": VISP}
    files |= {"franka_pose_cPo_1.yaml": VISP, "camera.xml": "<a/>"}
    dataset = read_dataset(write(tmp_path, files), Layout.visp, fixed_camera=fixed_camera)
    assert [(i.name, i.pose_id, i.cycle) for i in dataset.images] == [
        ("franka_image-2.png", "franka-2", 1),
        ("franka_image-10.png", "franka-10", 1),
    ]
    assert dataset.without_pose == ("franka_image-1.png",)
    assert dataset.without_image == ("franka_pose_rPe_3.yaml",)
    assert dataset.fixed_camera == fixed_camera
    assert_poses(dataset, T_BASE_FLANGE)


@pytest.mark.parametrize("static", [False, True])
def test_industrial_calibration_lists_its_views(tmp_path: Path, static: bool) -> None:
    dataset = read_dataset(write(tmp_path, industrial(static=static)), Layout.industrial_calibration)
    assert [(i.name, i.pose_id) for i in dataset.images] == [("images/0.png", "0"), ("images/1.png", "1")]
    assert dataset.fixed_camera == static
    assert_poses(dataset, T_BASE_FLANGE)


@pytest.mark.parametrize(("folder", "count"), [("charuco", 8), ("circles_10x10", 15)])
def test_datasets_of_robot_cal_tools_are_read_as_they_are(data_folder: Path, folder: str, count: int) -> None:
    """Their `cal_data.yaml` is the list alone; half of the ChArUco images are not in the repository's data."""
    dataset = read_dataset(data_folder / "robot_cal_tools" / folder, Layout.industrial_calibration)
    first = next(pose for pose in dataset.poses if pose["pose_id"] == "0")
    assert (len(dataset.images), len(dataset.poses), dataset.fixed_camera) == (count, count, False)
    assert len(dataset.without_image) == (8 if folder == "charuco" else 0)
    if folder == "charuco":
        assert first["position_mm"] == pytest.approx([113.0742, 589.2803, 652.6738], abs=1e-3)


@pytest.mark.parametrize("name", ["cell.samples", "samples.json", "samples.yaml"])
def test_easy_handeye_has_samples_for_images_in_order(tmp_path: Path, name: str) -> None:
    files: dict[str, str | bytes] = {name: samples(), "10.png": small_image(1), "9.png": small_image(2)}
    folder = write(tmp_path, files)
    dataset = read_dataset(folder, Layout.easy_handeye)
    assert [(i.name, i.pose_id) for i in dataset.images] == [("9.png", "s1"), ("10.png", "s2")]
    assert_poses(dataset, T_BASE_FLANGE)
    # Of a fixed camera it stores the base in the effector.
    assert_poses(read_dataset(folder, Layout.easy_handeye, fixed_camera=True), invert(T_BASE_FLANGE))


IMAGE = small_image(1)


@pytest.mark.parametrize(
    ("layout", "files", "words"),
    [
        ("visp", {"a.png": IMAGE}, "no image with a pose"),
        ("visp", {"image-1.png": IMAGE, "pose_fPe_1.yaml": "data: [[1]]"}, "six numbers"),
        ("visp", {"image-1.png": IMAGE, "pose_fPe_1.yaml": VISP.replace("0.61", ".nan")}, "not a number"),
        ("visp", {"image-1.png": IMAGE, "image-01.png": IMAGE}, "same number"),
        ("visp", {"image-1.png": IMAGE, "pose_fPe_1.yaml": "- 1"}, "does not hold"),
        ("industrial_calibration", {"a.png": IMAGE}, "cannot be read"),
        ("industrial_calibration", {"cal_data.yaml": "data: 1"}, "no list"),
        ("industrial_calibration", {"cal_data.yaml": "data: [1]"}, "View 0"),
        ("industrial_calibration", {"cal_data.yaml": "data: [{image: ../a.png, pose: a}]"}, "not below"),
        ("easy_handeye", {"a.png": IMAGE}, "0 files"),
        ("easy_handeye", {"a.png": IMAGE, "a.samples": samples(2)}, "1 images for 2 samples"),
        ("easy_handeye", {"a.png": IMAGE, "a.samples": '{"samples": [1]}'}, "not a number"),
        ("easy_handeye", {"a.png": IMAGE, "a.samples": samples(1).replace('"w"', '"v"', 1)}, "not a number"),
        (
            "easy_handeye",
            {"a.png": IMAGE, "a.samples": samples(1).replace('"x": 0.61', '"x": true')},
            "not a number",
        ),
    ],
)
def test_what_does_not_have_the_layout_is_refused(
    tmp_path: Path, layout: str, files: dict[str, str | bytes], words: str
) -> None:
    with pytest.raises(FileRefused, match=words):
        read_dataset(write(tmp_path, files), Layout(layout))


def test_what_is_no_quaternion_is_refused(tmp_path: Path) -> None:
    files = industrial()
    files["poses/1.yaml"] = "{x: 1, y: 1, z: 1, qx: 1, qy: 1, qz: 0, qw: 0}"
    with pytest.raises(FileRefused, match=r"norm 1\.41421"):
        read_dataset(write(tmp_path, files), Layout.industrial_calibration)


def test_images_and_poses_arrive_in_a_new_session_once(served: Any, tmp_path: Path) -> None:
    folder = str(write(tmp_path, industrial()))
    words = (
        "sessions",
        "import",
        folder,
        "--layout",
        "industrial_calibration",
        "--target",
        "chessboard:9x6:25",
    )
    assert "2 images, each" in gridpose(served, *words, "--dry-run").stderr
    gridpose(served, *words, code=2)
    printed = gridpose(served, *words, "--session", "Hand-eye").stdout
    # The service runs in this process, and a line of its log may come last.
    (session,) = {line for line in printed.splitlines() if line.startswith("ses_")}
    again = gridpose(served, *words, "--session", "Hand-eye")
    assert "0 sent, 2 already there" in again.stderr
    items = served.client.get(f"/v1/sessions/{session}/measurements").json()["items"]
    sent = sorted((m["pose_id"], m["cycle"], m["filename"]) for m in items)  # two are sent at a time
    assert sent == [("0", 1, "0.png"), ("1", 1, "1.png")]
    stored = served.client.get(f"/v1/sessions/{session}/poses/1").json()
    np.testing.assert_allclose(matrix(stored), T_BASE_FLANGE, atol=1e-9)
    write(tmp_path, {"poses/0.yaml": "{x: 1}"})
    gridpose(served, *words, "--session", "Hand-eye", code=2)


def test_a_fixed_camera_is_stated_of_the_session_and_poses_replaced(served: Any, tmp_path: Path) -> None:
    folder = str(write(tmp_path, industrial()))
    words = ("sessions", "import", folder, "--layout", "industrial_calibration", "--session", "Fixed")
    gridpose(served, *words, "--target", "chessboard:9x6:25")
    (session,) = served.client.get("/v1/sessions", params={"name": "Fixed"}).json()["items"]
    assert session["camera_mount"] == "robot"
    address = f"/v1/sessions/{session['id']}"
    served.client.put(
        f"{address}/poses/1", json={"position_mm": [1.0, 200.0, 3.0]}
    )  # as earlier versions sent
    for options in (("--fixed-camera",), ()):  # what the session knows stays
        gridpose(served, *words, *options)
        assert served.client.get(address).json()["camera_mount"] == "fixed"
        np.testing.assert_allclose(
            matrix(served.client.get(f"{address}/poses/1").json()), T_BASE_FLANGE, atol=1e-9
        )


@pytest.mark.parametrize("command", [pytest.param("upload", marks=pytest.mark.slow), "import"])
def test_a_session_that_got_nothing_is_deleted_again(
    serve_api: ApiMaker, tmp_path: Path, command: str
) -> None:
    bad = b"no image"
    if command == "upload":
        arguments = ["upload", str(write(tmp_path / "images", {"P1/1.png": bad}))]
    else:
        folder = write(tmp_path / "visp", {"image-1.png": bad, "pose_fPe_1.yaml": VISP})
        arguments = ["sessions", "import", str(folder), "--layout", "visp"]
    options = ("--session", "new", "--target", "chessboard:9x6:25", "--wait")
    with serve_api() as api:
        done = gridpose(api, *arguments, *options, code=1)
        assert "the new session is deleted again" in done.stderr
        assert "\nses_" not in f"\n{done.stdout}", "the id of a session that is gone is of no use"
        assert api.client.get("/v1/sessions").json()["items"] == []
