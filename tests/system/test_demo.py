"""`gridpose demo`, small and with `--paper`, from start to end, on a narrow terminal."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from app.cli.demo import paper
from tests.support.command_line import gridpose_here
from tests.support.simulation.renders import write_renders

SEED = ("--seed", "2")


def demo(folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "app.cli", "demo", "--data-dir", str(folder), *SEED],
        env={**os.environ, "COLUMNS": "100", "NO_COLOR": "1"},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )


def demo_of_the_paper(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """Run it in this process, on a narrow terminal."""
    settings = {"COLUMNS": "80", "GRIDPOSE_WORKERS": "1"}
    return gridpose_here("demo", "--paper", *options, "--data-dir", str(folder), *SEED, **settings)


def assert_table_iv(said: str, folder: Path) -> None:
    """Every line is what the service answered, and lies by the truth within its own uncertainty."""
    truth = json.loads((folder / "dh-truth.json").read_text())["global"]
    answer = json.loads((folder / "dh.json").read_text())["global"]
    rows = re.findall(
        r"^(\d| )  +(a|alpha|d|theta|beta)((?: +-?[\d.]+){2}) +(-?[\d.]+)((?: +[\d.]+){2}) +(-|[\d.]+) *$",
        said,
        re.MULTILINE,
    )
    identifiable = [p for p in truth if p["uncertainty"] is not None]
    assert len(rows) == len(identifiable) == 18
    assert len(re.findall(r"-    as sheet        -      - ", said)) == len(truth) - 18 == 7
    squares: dict[bool, list[float]] = {True: [], False: []}
    for (_, name, known, identified, figures, _), p in zip(rows, identifiable, strict=True):
        field = {"theta": "theta_offset"}.get(name, name) + ("_mm" if name in "ad" else "_deg")
        joint = answer["joints"][p["joint"] - 1]
        digits = 4 if name in "ad" else 5
        assert p["name"] == name
        assert known.split()[1] == f"{p['true']:.{digits}f}"
        assert identified == f"{joint[field]:.{digits}f}"
        uncertainty, ratio = (float(value) for value in figures.split())
        assert uncertainty == pytest.approx(joint["standard_uncertainty"][field], abs=0.6 * 10.0**-digits)
        assert ratio == pytest.approx(abs(joint[field] - p["true"]) / p["uncertainty"], abs=0.006)
        assert ratio < 5.0
        squares[name in "ad"].append((joint[field] - p["true"]) ** 2)
    # Arms are drawn .3 mm and .03° off their data sheet along each parameter.
    assert sum(squares[True]) / len(squares[True]) < 0.06**2
    assert sum(squares[False]) / len(squares[False]) < 0.006**2
    assert re.search(r"^cpa: circles.* +\d\.\d{4} +\d\.\d{5} ", said, re.MULTILINE)
    assert answer["null_space"][0]["sentence"] in " ".join(said.split())


def test_the_small_demo_shows_a_table_of_poses_and_keeps_what_it_made(tmp_path: Path) -> None:
    folder = tmp_path / "kept"
    ended = demo(folder)
    said = ended.stdout
    assert ended.returncode == 0, said + ended.stderr
    assert ended.stderr == ""
    paths = (
        str(folder),
        "bin/gridpose",
        "GRIDPOSE_",
    )  # as long as they are, for copying, as are an address and a key
    lines = [
        line for line in said.splitlines() if " " in line.strip() and not any(path in line for path in paths)
    ]
    assert max(map(len, lines)) <= 80
    assert re.search(r"The service runs at http://127\.0\.0\.1:\d+", said)
    assert "31 photographs measured; 30 determine the camera by themselves" in " ".join(said.split())
    assert "focal_not_observable" in said
    repeatability = {
        row["pose_id"]: row for row in json.loads((folder / "repeatability.json").read_text())["poses"]
    }
    rows = re.findall(
        r"^(P\d) +(\d+) +([\d.]+) +([\d.]+) - ([\d.]+) +([\d.]+) +([\d.]+)  (\w+)", said, re.MULTILINE
    )
    assert [row[0] for row in rows] == ["P1", "P2", "P3"]
    for pose_id, images, reading, low, high, floor, true, verdict in rows:
        answer = repeatability[pose_id]
        values = [answer["repeatability"], answer["noise_floor"]]
        assert [reading, floor] == [f"{value['rp_l_mm']:.4f}" for value in values]
        assert [low, high] == [f"{value:.4f}" for value in answer["interval"]["rp_l_mm"]]
        assert (int(images), verdict) == (answer["cycles"], answer["verdict"])
        assert 0.05 < float(true) < 0.2
    assert ElementTree.parse(folder / "scatter.svg").getroot().tag.endswith("svg")
    assert f"serve --data-dir {folder}" in said
    assert (folder / "gridpose.sqlite3").exists()


@pytest.mark.slow
def test_it_calibrates_refuses_and_reports_the_truth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its images are the tests' own renders: how a demo renders is shown by the small one."""
    monkeypatch.setattr(paper, "render_images", write_renders)
    folder = tmp_path / "kept"
    ended = demo_of_the_paper(folder, "--quick")
    said = ended.stdout
    assert ended.returncode == 0, said + ended.stderr
    assert "51 photographs measured; 50 determine the camera by themselves" in " ".join(said.split())
    assert "focal_not_observable" in said
    tables, where = said.split("All of it is kept in")
    assert max(len(line.rstrip()) for line in tables.splitlines()) <= 80
    assert "…" not in tables  # nothing had to be cut

    truth = {(f["pose_id"], f["name"]): f for f in json.loads((folder / "truth.json").read_text())}
    assert len(truth) == 35
    repeatability = json.loads((folder / "repeatability.json").read_text())
    rows = re.findall(
        r"^(P\d)((?: +[\d.]+){3}) +([\d.]+) - ([\d.]+)((?: +[\d.]+){2})  (\w+)", tables, re.MULTILINE
    )
    assert [row[0] for row in rows] == ["P1", "P2", "P3", "P4", "P5"]
    for (pose_id, first, low, high, last, verdict), answer in zip(rows, repeatability["poses"], strict=False):
        figure = truth[pose_id, "rp_l_mm"]
        reading, floor = answer["repeatability"]["rp_l_mm"], answer["noise_floor"]["rp_l_mm"]
        corrected = answer["corrected"]["rp_l_mm"]
        shown = [figure["true"], figure["of_these_cycles"], reading]
        assert first.split() == [f"{value:.4f}" for value in shown]
        assert last.split() == [f"{value:.4f}" for value in (corrected, floor)]
        assert [low, high] == [f"{value:.4f}" for value in answer["interval"]["rp_l_mm"]]
        assert verdict == answer["verdict"] == "robot"

    assert_table_iv(tables, folder)

    comparison = json.loads((folder / "comparison.json").read_text())
    marker, board = (
        {row["method"]: row for row in comparison["repeatabilities"]}[m] for m in ("aruco_marker", "pooled")
    )
    for one, all_of_it in zip(marker["poses"][:5], board["poses"][:5], strict=True):
        assert one["repeatability"]["rp_l_mm"] > 3.0 * all_of_it["repeatability"]["rp_l_mm"]
    for name in ("scatter.svg", "drift.svg", "residuals.svg"):
        assert ElementTree.parse(folder / name).getroot().tag.endswith("svg")
    for kept in re.findall(r"^  ([\w.-]+\.(?:json|svg|png|sqlite3)) ", where, re.MULTILINE):
        assert (folder / kept).exists(), kept

    again = demo_of_the_paper(folder)
    assert again.returncode == 2
    assert "is not empty" in again.stdout
