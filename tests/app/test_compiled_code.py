"""Compiled kernels are made before the first job, and kept where they can be."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from app.jobs.warm_up import warm_up
from app.jobs.worker_process import keep_compiled_code


def test_the_warming_picture_is_calibrated() -> None:
    """A worker that cannot do this one can do no other."""
    warm_up()


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
