"""The client without the service: its face, its command line, and rotations without NumPy."""

from __future__ import annotations

import ast
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import app.client
import app.client.commands
from app.cli.main import SERVICE_COMMANDS
from app.client.commands import make_app, rotations
from app.client.commands.table import CLIENT, SERVICE
from core.geometry import rotation_to_rpy, so3_exp

CLIENT_FOLDER = Path(app.client.__file__).parent
RNG = np.random.default_rng(17)
VECTORS = [
    *RNG.normal(0.0, 1.5, (6, 3)),
    np.zeros(3),
    np.array([math.pi, 0.0, 0.0]),
    np.array([0.0, 0.0, 3.14]),
]


@pytest.mark.parametrize("package", [app.client, app.client.commands])
def test_a_face_gives_what_it_lists(package: object) -> None:
    names = package.__all__  # type: ignore[attr-defined]
    listed = {name for given in package._PLACES.values() for name in given}  # type: ignore[attr-defined]
    assert listed == set(names)
    assert all(getattr(package, name) is not None for name in names)
    tree = ast.parse(Path(str(package.__file__)).read_text(encoding="utf-8"))  # type: ignore[attr-defined]
    typed = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module != "typing"]
    assert {a.name for node in typed for a in node.names} - {"lazy_face"} == set(names)
    with pytest.raises(AttributeError):
        package.nothing  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.parametrize("source", sorted(CLIENT_FOLDER.rglob("*.py")), ids=str)
def test_only_relative_imports_name_what_is_ours(source: Path) -> None:
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and node.level == 0:
            names = [node.module or ""]
        assert not {name.partition(".")[0] for name in names} & {"app", "core", "migrations", "gridpose"}


def test_every_command_of_the_service_is_implemented() -> None:
    assert set(SERVICE_COMMANDS) == set(SERVICE)
    assert not set(SERVICE) & set(CLIENT)


@pytest.mark.parametrize("command", ["serve --port 3", "targets print -o board.pdf", "robots plan dh"])
def test_a_command_of_the_service_says_how_to_get_it(command: str) -> None:
    ended = CliRunner().invoke(make_app(), command.split())
    assert ended.exit_code == 2
    assert "gridpose[server]" in ended.output


@pytest.mark.parametrize("vector", VECTORS)
def test_rotations_are_those_of_core(vector: np.ndarray) -> None:
    R = so3_exp(vector)
    np.testing.assert_allclose(rotations.from_vector(vector.tolist()), R, atol=1e-12)
    x, y, z, w = rotations.to_quaternion(R.tolist())
    np.testing.assert_allclose(Rotation.from_quat([x, y, z, w]).as_matrix(), R, atol=1e-12)
    np.testing.assert_allclose(rotations.from_quaternion(2 * x, 2 * y, 2 * z, 2 * w), R, atol=1e-12)
    np.testing.assert_allclose(rotations.to_roll_pitch_yaw(R.tolist()), rotation_to_rpy(R), atol=1e-12)
    angles = rotations.to_roll_pitch_yaw(R.tolist())
    np.testing.assert_allclose(rotations.from_roll_pitch_yaw(*angles), R, atol=1e-12)


def test_a_vertical_pitch_has_angles() -> None:
    R = rotations.from_roll_pitch_yaw(0.3, math.pi / 2.0, 0.1)
    np.testing.assert_allclose(rotations.from_roll_pitch_yaw(*rotations.to_roll_pitch_yaw(R)), R, atol=1e-9)
