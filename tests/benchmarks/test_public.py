"""The public benchmark: its suite, its images, its adapters and its figures, on small images."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.public.adapters import BUILT_IN, load
from benchmarks.public.adapters.opencv_aruco import labels_of_markers
from benchmarks.public.photographs import projection_uncertainty
from benchmarks.public.rendering import image_of, path_of, prepare_images, render_item
from benchmarks.public.report import document, exceptions, table
from benchmarks.public.runner import measure
from benchmarks.public.scoring import Score, found_fraction, ratio_on_common, rms_px, score
from benchmarks.public.suite import SIZE_PX, TARGETS, Condition, Disc, Item, items, labelled_points
from core import Camera, TargetSpec
from core.geometry import project, so3_exp, transform
from core.simulation import Scene

CAMERA = Camera(400.0, 400.0, 159.5, 119.5)
POSE = transform(so3_exp(np.array([0.3, -0.2, 0.1])), np.array([-55.0, -40.0, 260.0]))
SMALL = Scene(TargetSpec("chessboard", 7, 5, 20.0), CAMERA, POSE, 320, 240, blur_px=0.8, noise_levels=1.0)


def _item(condition: Condition, disc: Disc | None = None) -> Item:
    return Item("small board", condition, 1, SMALL, disc)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Item], Path]:
    """A board in full view, and one whose first corner is hidden, rendered."""
    folder = tmp_path_factory.mktemp("images")
    hidden = Disc(SMALL.points_px[0], 45.0, 90.0)
    suite = [_item(Condition()), _item(Condition("occlusion", occluded=0.1), hidden)]
    assert prepare_images(suite, folder, jobs=1) == 2
    return suite, folder


def test_the_suite_is_the_promised_one() -> None:
    suite = list(items())
    assert len(suite) <= 200
    assert {item.target_name for item in suite} == set(TARGETS)
    assert len({path_of(item, Path()) for item in suite}) == len(suite)
    first = [path_of(item, Path()) for item in suite if item.seed == 1]
    assert [path_of(item, Path()) for item in items(seeds=(1,))] == first


def test_every_grid_point_is_in_the_image_and_the_disc_hides_the_stated_fraction() -> None:
    for item in items(seeds=(1,)):
        truth = item.truth_px[: item.scene.target.size]
        assert np.all((truth > 0) & (truth < np.array(SIZE_PX) - 1))
        hidden = 1.0 - np.mean(item.visible[: item.scene.target.size])
        assert hidden >= item.condition.occluded - 0.01
        assert hidden <= item.condition.occluded + 0.08  # the points near the disc's blurred edge


def test_an_image_is_rendered_once(small: tuple[list[Item], Path]) -> None:
    suite, folder = small
    assert prepare_images(suite, folder, jobs=1) == 0
    other = replace(suite[0], scene=replace(SMALL, noise_levels=2.0))
    assert path_of(other, folder) != path_of(suite[0], folder)


def test_the_disc_hides_what_is_behind_it_and_nothing_else(small: tuple[list[Item], Path]) -> None:
    suite, folder = small
    clear, hidden = (image_of(item, folder).astype(float) for item in suite)
    u, v = np.rint(SMALL.points_px[0]).astype(int)
    assert np.all(np.abs(hidden[v - 4 : v + 5, u - 4 : u + 5] - 90.0) < 6.0)
    assert np.array_equal(clear[-40:, -60:], hidden[-40:, -60:])


def test_detectors_are_measured_against_the_truth(small: tuple[list[Item], Path]) -> None:
    suite, folder = small
    scores, notes = measure([load("opencv_classic"), load("gridpose")], suite, folder)
    assert notes == []
    ours, theirs = scores["small board", "gridpose"], scores["small board", "opencv_classic"]
    assert found_fraction(ours[:1]) == found_fraction(theirs[:1]) == 1.0
    assert rms_px(ours[:1]) < 0.03
    assert rms_px(theirs[:1]) < 0.3
    assert ratio_on_common(theirs, ours) == pytest.approx(rms_px(theirs[:1]) / rms_px(ours[:1]))
    assert theirs[1].labels.size == 0  # it needs the whole board
    text = table(scores)
    assert text.count("\n") == 4
    assert f"{rms_px(ours[:1]):.4f}" in text
    assert "not found" in text
    rows = document(scores)
    assert len(rows) == 4
    assert rows[0]["points_found"] == SMALL.target.size
    assert rows[1]["rms_px"] is None


def test_an_adapter_from_a_file_is_run_and_one_that_is_broken_is_refused(
    small: tuple[list[Item], Path], tmp_path: Path
) -> None:
    suite, folder = small
    mine = tmp_path / "mine.py"
    mine.write_text(
        "import numpy as np\n"
        "def prepare(target):\n    return target\n"
        "def detect(prepared, image):\n    return np.array([0, 999]), np.zeros((2, 2))\n"
    )
    with pytest.raises(ValueError, match="0 to 34"):
        measure([load(str(mine))], suite, folder)
    mine.write_text("def prepare(target):\n    return None\n")
    with pytest.raises(ValueError, match="detect"):
        load(str(mine))
    with pytest.raises(ValueError, match="opencv_sb"):
        load("no_such_adapter")


def test_a_package_that_is_absent_is_named_with_how_to_install_it(tmp_path: Path) -> None:
    absent = tmp_path / "absent.py"
    absent.write_text(
        "from benchmarks.public.adapters import NotInstalled\n"
        "def prepare(target):\n    raise NotInstalled('pip install nothing-at-all')\n"
        "def detect(prepared, image):\n    raise AssertionError\n"
    )
    scores, notes = measure([load(str(absent))], [_item(Condition())], tmp_path)
    assert scores == {}
    assert "pip install nothing-at-all" in notes[0]


def test_wrong_points_and_points_delivered_twice_count_as_such() -> None:
    item = _item(Condition())
    truth = item.truth_px
    labels = np.array([0, 1, 1, 2, 3, 4, 5])
    points = truth[labels] + [[0.1, 0.0]]
    points[3] += 5.0
    found = score(item, labels, points, markers=False, seconds=0.0)
    assert (found.asked, found.wrong) == (35, 1)
    assert sorted(found.labels) == [0, 1, 3, 4, 5]
    assert rms_px([found]) == pytest.approx(np.sqrt(0.1**2 / 2))


def test_a_chessboard_may_be_counted_from_any_end() -> None:
    item = _item(Condition())
    found = score(item, np.arange(35), item.truth_px[::-1], markers=False, seconds=0.0)
    assert (len(found.labels), found.wrong) == (35, 0)


def test_what_another_detector_does_better_is_said() -> None:
    item = _item(Condition())
    labels = np.arange(35)

    def scored(error_px: float, count: int) -> list[Score]:
        errors = np.full((count, 2), error_px)
        return [Score(item, 35, 0, labels[:count], errors, 0.01)]

    worse = {("b", "other"): scored(0.2, 30), ("b", "gridpose"): scored(0.1, 35)}
    assert exceptions(worse) == ""
    better = {("b", "other"): scored(0.05, 35), ("b", "gridpose"): scored(0.1, 30)}
    assert "0.50 of our error" in exceptions(better)
    assert "finds 100 %" in exceptions(better)


@pytest.mark.parametrize("kind", ["charuco", "aprilgrid"])
def test_markers_are_labelled_as_opencv_reads_them(kind: str) -> None:
    """OpenCV reads ids and corner order from a sheet drawn flat, in the target frame."""
    target = next(t for t in TARGETS.values() if t.kind == kind)
    size = (600, 500)
    camera = Camera(660.0, 660.0, 299.5, 249.5)
    middle = target.points_target().mean(axis=0)
    scene = Scene(target, camera, transform(np.eye(3), np.array([-middle[0], -middle[1], 400.0])), *size)
    if kind == "aprilgrid":
        scene = replace(scene, T_camera_target=transform(np.eye(3), np.array([-131.0, -131.0, 420.0])))
    item = Item(kind, Condition(), 1, scene, None)
    adapter = load("opencv_aruco")
    labels, points = adapter.detect(adapter.prepare(target), render_item(item))
    truth = project(labelled_points(target) + scene.T_camera_target[:3, 3], camera)
    assert len(labels) > 40
    assert np.all(np.linalg.norm(points - truth[labels], axis=1) < 1.0)
    assert len(np.unique(labels_of_markers(target))) == labels_of_markers(target).size


def test_built_in_adapters_say_which_targets_they_have() -> None:
    boards = {
        kind: next(t for t in TARGETS.values() if t.kind == kind) for kind in ("chessboard", "aprilgrid")
    }
    for name in set(BUILT_IN) - {"pupil_apriltags"}:
        prepared = {kind: load(name).prepare(target) for kind, target in boards.items()}
        assert (prepared["chessboard"] is None) == (name in ("opencv_charuco", "opencv_aruco"))
        assert (prepared["aprilgrid"] is None) == (name not in ("opencv_aruco", "gridpose"))


def test_projection_uncertainty_is_that_of_repeated_calibrations() -> None:
    """Compared with the scatter of where far points are seen, over calibrations with noise drawn anew."""
    rng = np.random.default_rng(7)
    target = SMALL.target.points_target()
    tilts = [
        [0.5, 0.1, 0.0],
        [-0.5, 0.1, 0.4],
        [0.1, 0.5, 0.2],
        [0.0, -0.5, 0.9],
        [0.4, 0.4, 1.4],
        [-0.4, 0.3, 0.0],
    ]
    poses = []
    for tilt in tilts:
        R = so3_exp(np.array(tilt))
        poses.append(transform(R, np.array([0.0, 0.0, 260.0]) - R @ target.mean(axis=0)))
    exact = [project(target @ T[:3, :3].T + T[:3, 3], CAMERA) for T in poses]
    query, sigma, draws = np.array([[159.5, 119.5], [60.0, 50.0]]), 0.1, 60
    far = np.column_stack([(query - [159.5, 119.5]) / 400.0, np.ones(2)])
    seen = []
    for _ in range(draws):
        points = [(p + rng.normal(0.0, sigma, p.shape)).astype(np.float32) for p in exact]
        _, K, lens, rotations, _ = cv2.calibrateCamera(
            [target.astype(np.float32)] * len(poses),
            points,
            (320, 240),
            CAMERA.matrix,
            None,
            flags=cv2.CALIB_FIX_K3 | cv2.CALIB_USE_INTRINSIC_GUESS,
        )
        turns = [so3_exp(np.ravel(r)) @ T[:3, :3].T for r, T in zip(rotations, poses, strict=True)]
        found = Camera(K[0, 0], K[1, 1], K[0, 2], K[1, 2], *np.ravel(lens)[:4])
        seen.append(project(far @ np.mean(turns, axis=0).T, found))
    of_draws = [np.sqrt(np.linalg.eigvalsh(np.cov(np.array(seen)[:, k].T))[-1]) for k in range(2)]
    ones = [np.ones(len(target))] * len(poses)
    noise = [rng.normal(0.0, sigma, p.shape) for p in exact]
    stated = projection_uncertainty(CAMERA, poses, [target] * len(poses), ones, noise, query)
    # a standard deviation from 60 draws is known to 9 %, the noise's own from 420 residuals to 3.5 %
    assert stated == pytest.approx(of_draws, rel=4 * 0.1)
