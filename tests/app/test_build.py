"""The build: the same wherever the sources lie, another one as soon as they differ."""

from __future__ import annotations

import compileall
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import core
from app.analyses.service import entity_tag
from app.build import analyses_build, core_version, program_version, sources_hash

Change = Callable[[Path], None]


@pytest.fixture
def copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the numerics' sources under another name, which may be changed."""
    folder = tmp_path / "elsewhere" / "numerics"
    shutil.copytree(Path(core.__file__).parent, folder, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.syspath_prepend(str(folder.parent))
    return folder


def test_the_build_is_that_of_the_sources_wherever_they_lie(copied: Path) -> None:
    assert core_version() == f"{program_version()}+{sources_hash('core')}"
    assert len(core_version()) <= 32, "the column's width"
    assert sources_hash("numerics") == sources_hash("core")
    assert "numerics" not in sys.modules, "hashing imports nothing"


def test_line_endings_and_compiled_files_change_nothing(copied: Path) -> None:
    before = sources_hash("numerics")
    for source in copied.rglob("*.py"):
        source.write_bytes(source.read_bytes().replace(b"\n", b"\r\n"))
    compileall.compile_dir(str(copied), quiet=1, maxlevels=0)
    assert (copied / "__pycache__").is_dir()
    assert sources_hash("numerics") == before


def _some_file(folder: Path, suffix: str) -> Path:
    return min(folder.rglob(f"*{suffix}"))


def _changed(folder: Path) -> None:
    path = _some_file(folder, ".py")
    path.write_bytes(path.read_bytes() + b"#")


def _renamed(folder: Path) -> None:
    path = _some_file(folder, ".py")
    path.rename(path.with_stem(f"{path.stem}_2"))


def _moved(folder: Path) -> None:
    """Put the boundary of two files elsewhere."""
    first, second = folder / "targets" / "a1.py", folder / "targets" / "a2.py"
    first.write_bytes(b"x")
    second.write_bytes(b"yz")


@pytest.mark.parametrize("change", [_changed, _renamed, _moved])
def test_any_other_change_is_another_build(copied: Path, change: Change) -> None:
    before = sources_hash("numerics")
    change(copied)
    after = sources_hash("numerics")
    assert after != before
    if change is _moved:
        (copied / "targets" / "a1.py").write_bytes(b"xy")
        (copied / "targets" / "a2.py").write_bytes(b"z")
        assert sources_hash("numerics") not in (before, after)


def test_compiled_files_alone_have_a_build_of_their_own(copied: Path) -> None:
    before = sources_hash("numerics")
    compileall.compile_dir(str(copied), quiet=1, legacy=True)
    assert sources_hash("numerics") == before, "sources come first"
    for path in copied.rglob("*.py"):
        path.unlink()
    stripped = sources_hash("numerics")
    assert stripped.startswith("pyc.")
    _some_file(copied, ".pyc").unlink()
    assert sources_hash("numerics") != stripped
    for path in copied.rglob("*.pyc"):
        path.unlink()
    with pytest.raises(ModuleNotFoundError):
        sources_hash("numerics")


def test_a_tag_does_not_outlive_the_service_that_wrote_the_document(monkeypatch: pytest.MonkeyPatch) -> None:
    before = entity_tag("0" * 64)
    assert entity_tag("0" * 64) == before
    monkeypatch.setattr("app.analyses.service.analyses_build", lambda: f"{analyses_build()}1")
    assert entity_tag("0" * 64) != before


@pytest.mark.slow
def test_the_build_is_shown_wherever_a_result_or_the_service_is(computing_api: Any, board_png: bytes) -> None:
    session = computing_api.make_session()
    measured = computing_api.wait_for(computing_api.put_image(session, board_png).json()["id"])
    assert measured["status"] == "succeeded"
    with computing_api.installation.database.read() as records:
        stored = records.connection().exec_driver_sql("SELECT core_version FROM results").scalars().all()
    assert stored == [core_version()]
    document = computing_api.client.get(f"/v1/sessions/{session}/intrinsics").json()
    assert document["core_version"] == core_version()
    assert computing_api.client.get("/readyz").json()["version"] == core_version()
    assert f'version="{core_version()}"' in computing_api.client.get("/metrics").text
    # The contract has a version; its document does not change with every build.
    assert computing_api.client.get("/openapi.json").json()["info"]["version"] == program_version()
