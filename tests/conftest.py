"""Shared by all tests: shapes in core's signatures are checked while tests run, and where the real data lies."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from jaxtyping import install_import_hook

# Before any import of core: annotations such as Float[np.ndarray, "n 3"] become run-time checks.
# The numeric tower: an int is a fine float, as everywhere in Python.
install_import_hook("core", "beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))")

# Deadlines would make the suite depend on the machine's speed; the seed is fixed so that a failure repeats.
settings.register_profile(
    "gridpose", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("gridpose")


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Real photographs and published measurements, which are not part of the project."""
    default = Path(__file__).parent.parent.parent / "shared" / "data"
    folder = Path(os.environ.get("GRIDPOSE_TEST_DATA", default))
    if not folder.is_dir():
        pytest.skip("the real photographs are not here: set GRIDPOSE_TEST_DATA to their folder")
    return folder
