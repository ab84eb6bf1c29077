"""Kernels are compiled before the first job, and stored where they can be."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest

from app.jobs.warm_up import CHESSBOARD, kernels_by_module, warm_up
from app.jobs.worker_init import keep_compiled_code
from core import Camera, TargetSpec, calibrate_targets
from core.geometry import so3_exp, transform
from core.jit import _parsed
from core.kinematics.dh import pose_with_jacobian
from core.simulation import Scene, render

BOARDS = (
    CHESSBOARD,
    TargetSpec("charuco", 6, 4, pitch_mm=13.0, marker_mm=10.0, dictionary="DICT_4X4_50"),
    TargetSpec("circles", 5, 4, pitch_mm=14.0),
    TargetSpec("asymmetric_circles", 4, 5, pitch_mm=9.0),
    TargetSpec("aprilgrid", 3, 3, pitch_mm=26.0, marker_mm=20.0),
)
PARTIAL_PX = 190
"""Columns of an image that a part of the board fills."""


def _small_image(
    board: TargetSpec, *, bit_depth: int = 8, marks: bool = False, origin_dot: float = 1.0, seed: int = 0
) -> np.ndarray:
    tilt = so3_exp(np.array([np.radians(35.0), 0.0, 0.1]))
    middle_mm = board.points_target().mean(axis=0)
    scene = Scene(
        target=board,
        camera=Camera(300.0, 300.0, 159.5, 119.5),
        T_camera_target=transform(tilt, np.array([0.0, 0.0, 120.0]) - tilt @ middle_mm),
        width_px=320,
        height_px=240,
        noise_levels=2.0,
        bit_depth=bit_depth,
        marks=marks,
        origin_dot=origin_dot,
        seed=seed,
    )
    return render(scene)


def _compiled_undeclared() -> tuple[set[str], list[str], list[str]]:
    """Do what jobs and analyses do; return the kernels used, the signatures compiled though not declared, and what
    failed."""
    warm_up()
    failed: list[str] = []
    for bit_depth in (8, 16):
        for board in BOARDS:
            image = _small_image(board, bit_depth=bit_depth, seed=5)
            larger = cv2.resize(image, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_CUBIC)
            failed += _failures(image, [board]) + _failures(larger, [board])
            _failures(image, BOARDS)
            _failures(np.ascontiguousarray(image[:, :PARTIAL_PX]), [board])
        marked = _small_image(CHESSBOARD, bit_depth=bit_depth, marks=True, seed=6)
        failed += _failures(marked, [CHESSBOARD])
        _failures(np.ascontiguousarray(marked[:, :PARTIAL_PX]), [CHESSBOARD])
        failed += _failures(_small_image(BOARDS[2], bit_depth=bit_depth, origin_dot=1.5), [BOARDS[2]])
    failed += _failures(_small_image(CHESSBOARD), [CHESSBOARD], ".jpg")
    pose_with_jacobian(np.zeros((2, 5)), np.zeros((1, 2)), np.eye(4)[None], np.eye(4))
    used, undeclared = set(), []
    for module, kernels in kernels_by_module().items():
        for kernel in kernels:
            if "_dispatcher" in vars(kernel) and kernel.signatures:
                used.add(f"{module}.{kernel.__name__}")
                declared = set(map(_parsed, kernel.declared))
                undeclared += [
                    f"{module}.{kernel.__name__}: {s}" for s in kernel.signatures if s not in declared
                ]
    return used, undeclared, failed


def _failures(image: np.ndarray, boards: Sequence[TargetSpec], extension: str = ".png") -> list[str]:
    outcomes = calibrate_targets(cv2.imencode(extension, image)[1].tobytes(), boards)
    return [outcome.failure.detail for outcome in outcomes if outcome.failure is not None]


@pytest.mark.slow
def test_jobs_compile_nothing_that_an_installation_did_not() -> None:
    """In a process of its own: what other tests have called would hide what the installation lacks."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        used, undeclared, failed = pool.submit(_compiled_undeclared).result(timeout=600)
    assert failed == []
    assert undeclared == []
    assert len(used) > 40


@pytest.mark.parametrize("writable", [True, False])
def test_kept_in_the_data_folder_only_where_the_program_may_not_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writable: bool
) -> None:
    for name in ("NUMBA_CACHE_DIR", "MPLCONFIGDIR"):
        monkeypatch.setenv(name, "")  # so that what is set below is undone
        monkeypatch.delenv(name)
    monkeypatch.setattr(os, "access", lambda path, mode: writable)
    keep_compiled_code(tmp_path)
    folders = [os.environ.get(name) for name in ("NUMBA_CACHE_DIR", "MPLCONFIGDIR")]
    compiled = tmp_path / "compiled"
    assert folders == ([None, None] if writable else [str(compiled), str(compiled / "matplotlib")])


def test_a_place_of_the_users_own_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/elsewhere")
    monkeypatch.setenv("MPLCONFIGDIR", "/elsewhere too")
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    keep_compiled_code(tmp_path)
    assert os.environ["NUMBA_CACHE_DIR"] == "/elsewhere"
    assert os.environ["MPLCONFIGDIR"] == "/elsewhere too"
