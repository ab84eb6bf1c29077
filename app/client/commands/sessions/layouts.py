"""Datasets of hand-eye calibration in the layouts of other programs: images, and the robot's pose at each.

`visp`
    `image-1.png` and `pose_fPe_1.yaml` (since ViSP 3.7 `pose_rPe_1.yaml`), with any prefix: the end effector in the
    robot's base as six numbers, x, y, z in m and the rotation vector in rad.
    https://github.com/lagadic/visp apps/calibration/hand-eye
`industrial_calibration`
    `cal_data.yaml` with `data`, a list of `image` and `pose`, paths below its folder; each pose file has x, y, z in m
    and the quaternion qx, qy, qz, qw. `static_camera: true`: the camera does not move with the robot. robot_cal_tools,
    which it comes from, has the list alone.
    https://github.com/ros-industrial/industrial_calibration examples/data
`easy_handeye`
    A `.samples` file (YAML or JSON) with `samples`, each with `robot`, a ROS Transform in m. easy_handeye keeps no
    images: those of the folder belong to the samples in natural order. With a fixed camera `robot` is the base in the
    effector, and nothing in the file says so.
    https://github.com/marcoesposito1988/easy_handeye2 easy_handeye2/handeye_sampler.py

Poses are T_base_flange, whether the camera is on the robot or fixed.
"""

from __future__ import annotations

import enum
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ... import ImageFile, Json
from ...images.files import SUFFIXES, natural_key
from ..record_files import FileRefused, read_mapping, read_structure
from ..rotations import Frame, from_quaternion, from_vector, to_roll_pitch_yaw

_VISP_POSE = re.compile(r"(?P<prefix>.*)pose_[fr]Pe_(?P<number>[0-9]{1,9})", re.IGNORECASE)
_VISP_IMAGE = re.compile(r"(?P<prefix>.*)image[-_](?P<number>[0-9]{1,9})", re.IGNORECASE)
_YAML = frozenset({".yaml", ".yml"})
_SAMPLES = frozenset({".samples", ".json", *_YAML})
_MM_PER_M = 1000.0
_MAX_NORM_ERROR = 1e-3


class Layout(enum.StrEnum):
    """Layouts of datasets."""

    visp = "visp"
    industrial_calibration = "industrial_calibration"
    easy_handeye = "easy_handeye"


@dataclass(frozen=True, slots=True)
class Dataset:
    """Images, the robot's poses in the API's form, what has no counterpart, and whether the camera stands still."""

    images: tuple[ImageFile, ...]
    poses: tuple[Json, ...]
    without_pose: tuple[str, ...]
    without_image: tuple[str, ...]
    fixed_camera: bool


def read_dataset(folder: Path, layout: Layout, *, fixed_camera: bool = False) -> Dataset:
    """Return the dataset of a folder; `fixed_camera` states what its files may say too.

    Raises FileRefused where the folder does not have the layout.
    """
    is_fixed = fixed_camera
    if layout is Layout.visp:
        pairs, without_pose, without_image = _visp(folder)
    elif layout is Layout.industrial_calibration:
        pairs, without_image, says_fixed = _industrial_calibration(folder)
        without_pose, is_fixed = [], fixed_camera or says_fixed
    else:
        pairs, without_pose, without_image = _easy_handeye(folder, fixed_camera=fixed_camera)
    if not pairs:
        raise FileRefused(
            f"{folder} has no image with a pose of the robot.", "Check the folder and --layout."
        )
    images = tuple(
        ImageFile(path, path.relative_to(folder).as_posix(), pose_id, 1) for pose_id, path, _ in pairs
    )
    poses = tuple(_body(pose_id, pose) for pose_id, _, pose in pairs)
    return Dataset(images, poses, tuple(without_pose), tuple(without_image), is_fixed)


def _body(pose_id: str, pose: Frame) -> Json:
    roll, pitch, yaw = (math.degrees(angle) for angle in to_roll_pitch_yaw(pose.rotation))
    return {
        "pose_id": pose_id,
        "position_mm": pose.position_mm,
        "roll_deg": roll,
        "pitch_deg": pitch,
        "yaw_deg": yaw,
    }


_Pairs = list[tuple[str, Path, Frame]]


def _visp(folder: Path) -> tuple[_Pairs, list[str], list[str]]:
    images: dict[tuple[str, int], Path] = {}
    files: dict[tuple[str, int], Path] = {}
    for path in _files(folder):
        pattern, found = (_VISP_POSE, files) if path.suffix.lower() in _YAML else (_VISP_IMAGE, images)
        match = pattern.fullmatch(path.stem)
        if match is None or (found is images and path.suffix.lower() not in SUFFIXES):
            continue
        key = (match["prefix"], int(match["number"]))
        if key in found:
            raise FileRefused(
                f"{found[key].name} and {path.name} have the same number.", "Remove one of them."
            )
        found[key] = path
    pairs = [
        (
            f"{prefix.strip('-_. ')}-{number}".lstrip("-"),
            images[prefix, number],
            _visp_pose(files[prefix, number]),
        )
        for prefix, number in sorted(images.keys() & files.keys())
    ]
    without_pose = [images[key].name for key in sorted(images.keys() - files.keys())]
    return pairs, without_pose, [files[key].name for key in sorted(files.keys() - images.keys())]


def _visp_pose(path: Path) -> Frame:
    data = read_mapping(path).get("data")
    rows = data if isinstance(data, list) else []
    values = [
        _number(path, "data", row[0] if isinstance(row, list) and len(row) == 1 else row) for row in rows
    ]
    if len(values) != 6:
        raise FileRefused(f"{path.name} has no six numbers in data.", "It is no pose vector of ViSP.")
    return Frame(from_vector(values[3:]), [_MM_PER_M * v for v in values[:3]])


def _industrial_calibration(folder: Path) -> tuple[_Pairs, list[str], bool]:
    path = folder / "cal_data.yaml"
    content = read_structure(path)
    settings = content if isinstance(content, dict) else {"data": content}
    entries = settings.get("data")
    if not isinstance(entries, list):
        raise FileRefused(f"{path.name} has no list `data`.", "It lists `image` and `pose` of each view.")
    pairs: _Pairs = []
    without_image: list[str] = []
    for number, entry in enumerate(entries):
        names = [entry.get(name) for name in ("image", "pose")] if isinstance(entry, dict) else [None]
        if not all(isinstance(name, str) for name in names):
            raise FileRefused(f"View {number} of {path.name} has no `image` and `pose`.")
        image, pose = (folder / str(name) for name in names)
        if not image.resolve().is_relative_to(folder.resolve()):
            raise FileRefused(f"{path.name} names the image {names[0]}, which is not below {folder}.")
        if not image.is_file():
            without_image.append(str(names[1]))
            continue
        fields = read_mapping(pose)
        pairs.append((image.stem, image, _transform(pose, fields, fields, ("qx", "qy", "qz", "qw"))))
    if len({pose_id for pose_id, _, _ in pairs}) < len(pairs):
        pairs = [(f"{number}", image, pose) for number, (_, image, pose) in enumerate(pairs)]
    return pairs, without_image, settings.get("static_camera") is True


def _easy_handeye(folder: Path, *, fixed_camera: bool) -> tuple[_Pairs, list[str], list[str]]:
    found = [(path, samples) for path in _files(folder) if (samples := _samples(path)) is not None]
    if len(found) != 1:
        raise FileRefused(
            f"{folder} has {len(found)} files with samples.",
            "Leave one .samples, .yaml or .json file with `samples`.",
        )
    path, samples = found[0]
    images = sorted(
        (p for p in _files(folder) if p.suffix.lower() in SUFFIXES), key=lambda p: natural_key(p.name)
    )
    if len(images) != len(samples):
        raise FileRefused(
            f"{folder} has {len(images)} images for {len(samples)} samples.",
            "easy_handeye keeps no images: save one at each sample, in the order of the samples.",
        )
    pairs = []
    for number, (image, sample) in enumerate(zip(images, samples, strict=True), start=1):
        robot = sample.get("robot") if isinstance(sample, dict) else None
        robot = robot.get("transform", robot) if isinstance(robot, dict) else {}
        parts = [robot.get(name) for name in ("translation", "rotation")]
        translation, rotation = (part if isinstance(part, dict) else {} for part in parts)
        pose = _transform(path, translation, rotation, ("x", "y", "z", "w"), f"sample {number} ")
        pairs.append((f"s{number}", image, pose.inverse() if fixed_camera else pose))
    return pairs, [], []


def _samples(path: Path) -> Sequence[Any] | None:
    """Return the samples that a file holds; None for another file."""
    if path.suffix.lower() not in _SAMPLES:
        return None
    samples = read_mapping(path).get("samples")
    return samples if isinstance(samples, list) else None


def _transform(
    path: Path,
    translation: Mapping[str, Any],
    rotation: Mapping[str, Any],
    names: Sequence[str],
    where: str = "",
) -> Frame:
    position = [_MM_PER_M * _number(path, f"{where}{name}", translation.get(name)) for name in "xyz"]
    x, y, z, w = (_number(path, f"{where}{name}", rotation.get(name)) for name in names)
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if abs(norm - 1.0) > _MAX_NORM_ERROR:
        raise FileRefused(f"{path.name}: {where}quaternion has the norm {norm:.6g}, not 1.")
    return Frame(from_quaternion(x, y, z, w), position)


def _number(path: Path, name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise FileRefused(f"{path.name}: {name} is not a number: {str(value)[:40]}.")
    return float(value)


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))
