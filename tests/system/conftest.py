"""Real services in processes of their own: the larger tier, but for what is in `test_smoke.py`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from app.cli.demo.service_process import ServiceProcess

_HERE = Path(__file__).parent


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what starts services of its own as slow, before items are selected by their marks."""
    for item in items:
        if item.path.is_relative_to(_HERE) and item.path.name != "test_smoke.py":
            item.add_marker(pytest.mark.slow)


@pytest.fixture
def service(tmp_path: Path) -> Iterator[ServiceProcess]:
    """A running service with one worker on a new data folder."""
    with ServiceProcess(tmp_path / "data", {"GRIDPOSE_WORKERS": "1"}) as process:
        yield process


@pytest.fixture
def make_service(tmp_path: Path) -> Iterator[Callable[..., ServiceProcess]]:
    """Make services that are not started; those still running at the end are killed."""
    made: list[ServiceProcess] = []

    def make(name: str = "data", **environment: str) -> ServiceProcess:
        process = ServiceProcess(tmp_path / name, {"GRIDPOSE_WORKERS": "1", **environment})
        made.append(process)
        return process

    yield make
    for process in made:
        process.kill()


@pytest.fixture(scope="session")
def photo(data_folder: Path) -> Path:
    """A real photograph of the 9 × 6 chessboard of 25 mm."""
    return data_folder / "opencv_samples" / "left01.jpg"
