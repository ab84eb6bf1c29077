"""Poses from several reflectors: recovery, covariance, and readings that do not fit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jaxtyping import Float
from scipy.stats import chi2
from typer.testing import CliRunner

from app.cli.main import app
from app.client.commands.measured_poses.instrument import parse_instrument, with_uncertainty
from app.client.commands.measured_poses.layout import ColumnLayout
from app.client.commands.measured_poses.parser import parse_poses
from app.client.commands.measured_poses.reflectors import Reading, fit, poses_of_reflectors, read_reflectors
from app.client.commands.record_files import FileRefused, read_records
from core.geometry import so3_exp, so3_log

PLACES = {"A": [0.0, 0.0, 0.0], "B": [120.0, 0.0, 10.0], "C": [0.0, 90.0, -20.0], "D": [60.0, 70.0, 80.0]}
R = so3_exp(np.array([0.4, -1.0, 2.2]))
T = np.array([900.0, -350.0, 1200.0])


def measured(name: str) -> Float[np.ndarray, "3"]:
    return np.asarray(T + R @ np.array(PLACES[name]))


def reading(
    name: str, point: Float[np.ndarray, "3"], pose_id: str = "P1", u_mm: float | None = None
) -> Reading:
    covariance = None if u_mm is None else np.diag([u_mm**2] * 3 + [0.0] * 3).tolist()
    pose = {
        "pose_id": pose_id,
        "cycle": 2,
        "joint_angles_deg": [1.0],
        "position_mm": point.tolist(),
        "rotation": None,
        "covariance": covariance,
    }
    return Reading(f"line {name}", name, pose)


@pytest.mark.parametrize("seed", range(4))
def test_a_flange_is_recovered_from_any_three_of_its_reflectors(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turned, moved = so3_exp(rng.uniform(-3, 3, 3)), rng.uniform(-3000, 3000, 3)
    q = [PLACES[name] for name in rng.permutation(list(PLACES))[:3]]
    found = fit([(moved + turned @ np.array(place)).tolist() for place in q], q, [0.01, 0.02, 0.03])
    np.testing.assert_allclose(found.position, moved, atol=1e-8)
    np.testing.assert_allclose(found.rotation, turned, atol=1e-10)
    assert max(found.residuals) < 1e-8


def test_the_covariance_is_that_of_the_errors() -> None:
    rng = np.random.default_rng(7)
    runs, u = 300, np.array([0.02, 0.01, 0.03, 0.02])
    squares = 0.0
    for _ in range(runs):
        points = [
            (measured(name) + sigma * rng.normal(size=3)).tolist()
            for name, sigma in zip(PLACES, u, strict=True)
        ]
        found = fit(points, list(PLACES.values()), u.tolist())
        error = np.concatenate([np.array(found.position) - T, so3_log(np.array(found.rotation) @ R.T)])
        squares += float(error @ np.linalg.solve(np.array(found.covariance), error))
    low, high = chi2.ppf([1e-4, 1.0 - 1e-4], 6 * runs)
    assert low < squares < high


def test_readings_of_one_pose_and_cycle_become_a_pose() -> None:
    readings = [reading(name, measured(name), u_mm=0.01) for name in "ABD"]
    readings += [reading(name, measured(name), "P2") for name in "ABCD"]
    ((place, first), (_, second)), errors, (residual_mm, _) = poses_of_reflectors(readings, PLACES)
    assert (errors, place, first["pose_id"], first["cycle"]) == ([], "line A", "P1", 2)
    assert residual_mm < 1e-9
    np.testing.assert_allclose(first["rotation"], R, atol=1e-10)
    assert np.linalg.eigvalsh(np.array(first["covariance"])).min() > 0.0
    assert second["covariance"] is None


@pytest.mark.parametrize(
    ("names", "moved_mm", "u_mm", "words"),
    [
        ("AB", 0.0, None, "three not on one line"),
        ("ABCC", 0.0, None, "twice"),
        ("ABCX", 0.0, None, "names X"),
        ("ABCD", 0.2, 0.01, "reflector D is"),
        ("ABCD", 20.0, None, "from where the others have it"),
    ],
)
def test_what_does_not_fit_is_an_error_of_its_line(
    names: str, moved_mm: float, u_mm: float | None, words: str
) -> None:
    places = PLACES | {"X": [1.0, 2.0, 3.0]}
    readings = [reading(n, T + R @ np.array(places[n]), u_mm=u_mm) for n in names]
    readings[-1].pose["position_mm"][0] += moved_mm
    poses, (error,), _ = poses_of_reflectors(readings, PLACES)
    assert poses == []
    assert words in error.message


@pytest.mark.parametrize(
    "text",
    [
        "name,x_mm,y_mm,z_mm\nA,0,0,0\nB,1,0,0\nC,2,0,0\n",
        "name,x_mm\nA,1\n",
        "name,x_mm,y_mm,z_mm\nA,0,0,0\nA,1,0,0\n",
    ],
)
def test_a_table_of_reflectors_that_makes_no_frame_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "places.csv"
    path.write_text(text)
    with pytest.raises(FileRefused):
        read_reflectors(path)


def test_an_instrument_s_uncertainty_grows_with_distance_and_gives_way_to_stated_ones() -> None:
    instrument = parse_instrument("0.0075 + 0.003")
    assert instrument.at([0.0, 2000.0, 0.0]) == pytest.approx(0.0135)
    bare = reading("A", np.array([2000.0, 0.0, 0.0])).pose
    assert np.diag(with_uncertainty(bare, instrument)["covariance"]) == pytest.approx(
        [0.0135**2] * 3 + [0.0] * 3
    )
    stated = reading("A", np.zeros(3), u_mm=0.5).pose
    assert with_uncertainty(stated, instrument) is stated
    for text in ("", "x", "0", "-1", "1+", "1+2+3", "1.2.3"):
        with pytest.raises(FileRefused):
            parse_instrument(text)


def test_columns_are_added(tmp_path: Path) -> None:
    path = tmp_path / "readings.csv"
    path.write_text("stage;probe;y;z\n100;0,25;2;3\n100;;2;3\n")
    poses, errors = parse_poses(read_records(path, None, None), ColumnLayout(columns={"x": "stage + probe"}))
    assert poses[0][1]["position_mm"] == [100.25, 2.0, 3.0]
    assert [error.message for error in errors] == ["probe is empty"]
    with pytest.raises(FileRefused, match="none"):
        parse_poses(read_records(path, None, None), ColumnLayout(columns={"x": "stage+none"}))


def test_the_command_fits_and_shows_the_first_pose(tmp_path: Path) -> None:
    places, readings = tmp_path / "places.csv", tmp_path / "readings.csv"
    places.write_text(
        "name,x_mm,y_mm,z_mm\n" + "".join(f"{n},{x},{y},{z}\n" for n, (x, y, z) in PLACES.items())
    )
    rows = [[pose, name, *measured(name).tolist()] for pose in ("P1", "P2") for name in PLACES]
    readings.write_text("pose,reflector,x,y,z\n" + "".join(",".join(map(str, row)) + "\n" for row in rows))
    words = ["measured-poses", "import", str(readings), "--reflectors", str(places), "--dry-run"]
    done = CliRunner().invoke(app, [*words, "--instrument-uncertainty", "0.01"])
    assert done.exit_code == 0, done.output
    assert "2 poses of 8 readings; the largest residual is 0.000 mm" in done.stderr
    pose: dict[str, Any] = json.loads(done.stdout)
    np.testing.assert_allclose(pose["position_mm"], T, atol=1e-8)
    assert np.sqrt(pose["covariance"][3][3]) == pytest.approx(0.01 / 100.0, rel=0.6)
    readings.write_text(readings.read_text().replace("P2,D", "P2,A"))
    assert CliRunner().invoke(app, words).exit_code == 1
