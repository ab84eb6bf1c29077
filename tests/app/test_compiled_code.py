"""Compiled kernels are made before the first job, and kept where they can be."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import pkgutil
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import cv2
import pytest

import core
from app.jobs.warm_up import BOARDS, CHESSBOARD, picture, warm_up, warm_up_the_rest
from app.jobs.worker_process import keep_compiled_code
from core import calibrate_targets
from core.compiled import _CompiledOnFirstUse


def test_the_warming_picture_is_calibrated() -> None:
    """A worker that cannot do this one can do no other."""
    warm_up()


def _signatures() -> set[tuple[str, str, str]]:
    """For what types every kernel of the numerics is compiled in this process: module, kernel, types."""
    found = set()
    for module in pkgutil.walk_packages(core.__path__, "core."):
        for kernel in vars(importlib.import_module(module.name)).values():
            if isinstance(kernel, _CompiledOnFirstUse) and "_dispatcher" in vars(kernel):
                types = kernel._dispatcher.nopython_signatures
                found |= {(module.name, kernel.__name__, str(one)) for one in types}
    return found


def _compiled_by_jobs() -> tuple[int, list[tuple[str, str, str]], list[str]]:
    """Warm up, measure pictures of every kind, and return how much was compiled before, what then, and what failed."""
    warm_up()
    warm_up_the_rest()
    before = _signatures()
    failed = []
    for bit_depth in (8, 16):
        views = [(board, picture(board, bit_depth=bit_depth, seed=5)) for board in BOARDS]
        views.append((CHESSBOARD, picture(CHESSBOARD, bit_depth=bit_depth, marks=True, seed=6)))
        for board, view in views:
            larger = cv2.resize(view, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_CUBIC)
            (outcome,) = calibrate_targets(cv2.imencode(".png", larger)[1].tobytes(), [board])
            if outcome.failure is not None:
                failed.append(f"{board.kind}, {bit_depth} bit: {outcome.failure.detail}")
    return len(before), sorted(_signatures() - before), failed


def test_no_job_compiles_anything_after_an_installation() -> None:
    """In a process of its own: what other tests have called would hide what the warming leaves out."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        before, new, failed = pool.submit(_compiled_by_jobs).result(timeout=300)
    assert failed == []
    assert before > 20
    assert new == []


@pytest.mark.parametrize("writable", [True, False])
def test_kept_in_the_data_folder_only_where_the_program_may_not_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writable: bool
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")  # so that what is set below is undone
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.setattr(os, "access", lambda path, mode: writable)
    keep_compiled_code(tmp_path)
    assert os.environ.get("NUMBA_CACHE_DIR") == (None if writable else str(tmp_path / "compiled"))


def test_a_place_of_the_users_own_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/elsewhere")
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    keep_compiled_code(tmp_path)
    assert os.environ["NUMBA_CACHE_DIR"] == "/elsewhere"
