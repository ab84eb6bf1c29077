"""The one decorator of compiled kernels."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from core.jit import jit

KERNEL = """
import sys
import numpy as np
from core.jit import jit

@jit
def total(values):
    result = 0.0
    for value in values:
        result += value / 2.0
    return result

if __name__ == "__main__":
    print(*{total(np.arange(5).astype(kind)) for kind in sys.argv[1:]}, sum(total.stats.cache_misses.values()))
"""


@jit
def _ratio(a: np.ndarray, b: np.ndarray) -> float:
    total = 0.0
    for i in range(len(a)):
        total += a[i] / b[i]
    return total


def test_a_kernel_is_compiled_and_divides_as_numpy_does() -> None:
    assert _ratio(np.array([1.0, 2.0]), np.array([2.0, 4.0])) == 1.0
    assert _ratio(np.array([1.0]), np.array([0.0])) == np.inf
    assert _ratio.signatures  # type: ignore[attr-defined]


@jit
def _sum_of_ratios(a: np.ndarray, b: np.ndarray) -> float:
    return _ratio(a, b) + _ratio(b, a)


def test_kernels_call_one_another() -> None:
    assert _sum_of_ratios(np.array([1.0, 2.0]), np.array([2.0, 4.0])) == 5.0


@jit("f8[:], i8")
def _scaled_sum(a: np.ndarray, factor: int) -> float:
    total = 0.0
    for value in a:
        total += factor * value
    return total


@jit("f8[:, ::1]")
def _sum_of_row_and_column(a: np.ndarray) -> float:
    return _scaled_sum(a[0], 2) + _scaled_sum(a[:, 0], 3)


def test_types_that_convert_without_loss_use_the_declared_signature() -> None:
    """A literal, a contiguous array and a strided one are one signature, not three."""
    assert _sum_of_row_and_column(np.ones((3, 4))) == 2.0 * 4 + 3.0 * 3
    assert _scaled_sum(np.ones(4), 2) == 2.0 * 4  # loads it where its caller's kept code needs it no more
    assert len(_scaled_sum.signatures) == 1  # type: ignore[attr-defined]


def test_types_that_fit_no_declared_signature_are_compiled_on_demand() -> None:
    assert _scaled_sum(np.ones(3, dtype=np.float32), 2) == 6.0
    assert "float32" in str(_scaled_sum.signatures)  # type: ignore[attr-defined]


def test_importing_kernels_does_not_import_numba(tmp_path: Path) -> None:
    module = tmp_path / "kernel.py"
    module.write_text(
        KERNEL.partition("    print(")[0] + "    print('numba' in sys.modules)", encoding="utf-8"
    )
    assert _run(module, tmp_path).strip() == "False"


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a module whose kernel was compiled; not to be changed."""
    folder = tmp_path_factory.mktemp("compiled")
    assert _compiled_by(_module(folder)) == 1
    return folder


@pytest.fixture
def compiled_module(compiled: Path, tmp_path: Path) -> Path:
    """A copy of that module with its machine code, in the test's own folder."""
    shutil.copytree(compiled, tmp_path, dirs_exist_ok=True)
    return tmp_path / "kernel.py"


def test_machine_code_is_kept_and_used_by_the_next_process(compiled: Path) -> None:
    assert len(_kept(compiled)) == 1
    assert _compiled_by(compiled / "kernel.py") == 0
    assert len(_kept(compiled)) == 1


@pytest.mark.slow
def test_nowhere_to_keep_the_code_is_no_failure(tmp_path: Path) -> None:
    """As in a container whose file system is read-only and whose user has no home."""
    module = _module(tmp_path)
    (tmp_path / "__pycache__").touch()
    assert _compiled_by(module, XDG_CACHE_HOME="/dev/null/none", HOME="/dev/null") == 1
    assert not _kept(tmp_path)


@pytest.mark.slow
def test_kept_code_is_found_in_a_copy_and_after_a_change_of_times(compiled: Path, tmp_path: Path) -> None:
    """Another path, another time, and a folder of one's own that holds nothing: the code next to the module is used."""
    module = compiled / "kernel.py"
    shutil.copytree(compiled, tmp_path / "two", copy_function=shutil.copyfile)
    os.utime(tmp_path / "two" / module.name, (1e9, 1e9))
    assert _compiled_by(tmp_path / "two" / module.name, NUMBA_CACHE_DIR=str(tmp_path / "own")) == 0
    assert not _kept(tmp_path / "own")


@pytest.mark.slow
def test_a_folder_of_the_users_own_serves_every_copy(tmp_path: Path) -> None:
    own = str(tmp_path / "own")
    modules = [_module(tmp_path / name) for name in ("one", "two")]
    assert [_compiled_by(module, NUMBA_CACHE_DIR=own) for module in modules] == [1, 0]
    assert not _kept(tmp_path / "one") + _kept(tmp_path / "two")


@pytest.mark.slow
def test_other_source_is_compiled_anew_and_code_of_long_ago_is_removed(
    compiled_module: Path, tmp_path: Path
) -> None:
    module = compiled_module
    (first,) = _kept(tmp_path)
    module.write_text(module.read_text() + "\n# another version\n", encoding="utf-8")
    assert _compiled_by(module) == 1
    assert len(_kept(tmp_path)) == 2
    os.utime(first, (1e9, 1e9))
    module.write_text(module.read_text() + "\n# and another\n", encoding="utf-8")
    assert _compiled_by(module) == 1
    assert first not in _kept(tmp_path)
    assert len(_kept(tmp_path)) == 2


@pytest.mark.slow
def test_a_change_of_a_called_kernel_in_another_module_compiles_the_caller_anew(
    tmp_path: Path,
) -> None:
    module, parts = _module(tmp_path), tmp_path / "parts.py"
    module.write_text(
        module.read_text()
        .replace("from core", "from parts import half\nfrom core")
        .replace("value / 2.0", "half(value)"),
        encoding="utf-8",
    )
    text = "from core.jit import jit\n\n@jit\ndef half(value):\n    return value / 2.0\n"
    parts.write_text(text, encoding="utf-8")
    assert [_compiled_by(module) for _ in range(2)] == [1, 0]
    parts.write_text(text.replace("value / 2.0", "value / 4.0 * 2.0"), encoding="utf-8")
    assert _compiled_by(module) == 1


@pytest.mark.slow
def test_a_changed_constant_of_another_module_compiles_the_kernel_anew(tmp_path: Path) -> None:
    module, constants = _module(tmp_path), tmp_path / "constants.py"
    module.write_text(
        module.read_text()
        .replace("from core", "from constants import HALF\nfrom core")
        .replace("value / 2.0", "value * HALF"),
        encoding="utf-8",
    )
    constants.write_text("HALF = 0.5\n", encoding="utf-8")
    assert [_compiled_by(module) for _ in range(2)] == [1, 0]
    constants.write_text("HALF = 0.5  # as before\n", encoding="utf-8")
    assert _compiled_by(module) == 0
    constants.write_text("HALF = 0.25\n", encoding="utf-8")
    assert _run(module, module.parent, "float64").split() == ["2.5", "1"]


def test_code_of_a_module_that_was_renamed_is_compiled_anew(compiled: Path, tmp_path: Path) -> None:
    """As by an upgrade that moves a module to another package: kept code asks for the old one."""
    module, text = tmp_path / "run.py", (compiled / "kernel.py").read_text()
    for package in ("before", "after"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "kernel.py").write_text(text, encoding="utf-8")
        module.write_text(
            f"from {package}.kernel import *\n{text[text.index('if __name__') :]}", encoding="utf-8"
        )
        assert [_compiled_by(module, NUMBA_CACHE_DIR=str(tmp_path / "kept")) for _ in range(2)] == [1, 0]
        shutil.rmtree(tmp_path / package)


@pytest.mark.parametrize(
    "damage",
    [pytest.param("cut", marks=pytest.mark.slow), "flipped", pytest.param("empty", marks=pytest.mark.slow)],
)
def test_damaged_code_is_never_run(compiled_module: Path, tmp_path: Path, damage: str) -> None:
    (kept,) = _kept(tmp_path)
    whole = kept.read_bytes()
    middle = len(whole) // 2
    flipped = whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :]
    kept.write_bytes({"cut": whole[:middle], "flipped": flipped, "empty": b""}[damage])
    assert [_compiled_by(compiled_module) for _ in range(2)] == [1, 0]


@pytest.mark.slow
def test_processes_that_compile_at_once_do_not_mix_up_their_code(tmp_path: Path) -> None:
    """Several signatures of one kernel, saved at the same time by processes of their own."""
    module = _module(tmp_path)
    kinds = ["float64", "float32", "int64", "int32"]
    command, environment = [sys.executable, str(module)], _environment(tmp_path)
    running = [
        subprocess.Popen([*command, kind], env=environment, stdout=subprocess.PIPE, text=True)
        for kind in kinds
    ]
    assert [process.communicate()[0].split() for process in running] == [["5.0", "1"]] * 4
    assert _compiled_by(module, kinds) == 0
    assert len(_kept(tmp_path)) == 4


def _module(folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    module = folder / "kernel.py"
    module.write_text(KERNEL, encoding="utf-8")
    return module


@pytest.mark.slow
def test_a_broken_numba_shows_its_cause(tmp_path: Path) -> None:
    """As when numba and numpy are of versions that do not go together."""
    module = tmp_path / "kernel.py"
    before = KERNEL.partition("    print(")[0]
    broken = "import numpy\nnumpy.no_such_function\n"
    for use in ("total(np.arange(5.0))", "total.signatures", "total._numba_type_"):
        module.write_text(f"{before}    {use}\n", encoding="utf-8")
        (tmp_path / "numba.py").write_text(broken, encoding="utf-8")
        with pytest.raises(subprocess.CalledProcessError) as caught:
            _run(module, tmp_path)
        assert "no_such" in caught.value.stderr.splitlines()[-1]
        assert "RecursionError" not in caught.value.stderr


def _kept(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.nbc"))


def _compiled_by(module: Path, kinds: Sequence[str] = ("float64",), **settings: str) -> int:
    """Run the module's kernel in a process of its own and return how many kernels that compiled."""
    total, compiled_kernels = _run(module, module.parent, *kinds, **settings).split()
    assert total == "5.0"
    return int(compiled_kernels)


def _environment(home: Path, **settings: str) -> dict[str, str]:
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2]), "PYTHONDONTWRITEBYTECODE": "1"}
    environment.pop("NUMBA_CACHE_DIR", None)
    return {**environment, "XDG_CACHE_HOME": str(home / "cache"), **settings}


def _run(module: Path, folder: Path, *arguments: str, **settings: str) -> str:
    done = subprocess.run(
        [sys.executable, str(module), *arguments],
        cwd=folder,
        env=_environment(folder, **settings),
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout
