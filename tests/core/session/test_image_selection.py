"""Which images methods are compared on: as many of every pose, within bounds, always the same ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from core.calibration.multi_view.view_stack import ViewStack
from core.session import CameraViews, ImageObservation, SessionData, select_images
from core.session.estimation.image_selection import MAX_IMAGES, MAX_POINTS, MAX_POSES
from core.targets.specification import TargetSpec

BOARD = TargetSpec("chessboard", 9, 6, 12.0)


def taken(pose: str, cycle: int, points: int = 140, **fields: Any) -> tuple[ImageObservation, int]:
    """An image and the number of its grid points."""
    values: dict[str, Any] = {
        "measurement_id": f"mea_{pose}_{cycle}",
        "pose_id": pose,
        "cycle": cycle,
        "image": "0" * 64,
        "target": 0,
        "focus_group": "default",
        "joint_angles_deg": None,
        "width_px": 640,
        "height_px": 480,
    }
    return ImageObservation(**{**values, **fields}), points


@dataclass(frozen=True)
class Chosen:
    images: list[ImageObservation]
    pose_ids: tuple[str | None, ...]
    warnings: list[str]


def choose(taken: Sequence[tuple[ImageObservation, int]]) -> Chosen:
    images = tuple(image for image, _ in taken)
    counts = np.array([count for _, count in taken])
    total = int(counts.sum())
    views = ViewStack(
        640,
        480,
        (BOARD, BOARD),
        np.array([image.target for image in images]),
        np.concatenate([[0], np.cumsum(counts)]),
        np.zeros(total, dtype=np.intp),
        np.zeros(total, dtype=np.intp),
        np.zeros((total, 2)),
        np.ones(total),
        np.zeros((total, 3)),
    )
    data = SessionData(
        (BOARD, BOARD),
        ("tgt_1", "tgt_2"),
        images,
        (CameraViews("default", np.arange(len(images)), views),),
    )
    selected = select_images(data)
    assert selected is not None
    return Chosen(
        [images[i] for i in selected.images], selected.pose_ids, [w.code for w in selected.warnings]
    )


def test_of_thousands_of_images_every_pose_keeps_as_many() -> None:
    everything = [taken(f"P{p}", c) for p in range(5) for c in range(1, 1001)]
    chosen = choose(everything)
    assert len(chosen.images) == MAX_IMAGES
    assert chosen.warnings == ["images_sampled"]
    for pose in range(5):
        cycles = [i.cycle for i in chosen.images if i.pose_id == f"P{pose}"]
        assert len(cycles) == MAX_IMAGES // 5
        assert (cycles[0], cycles[-1]) == (1, 1000)
    assert choose(everything).images == chosen.images
    assert choose(everything[:MAX_IMAGES]).warnings == []
    # a pose of few keeps them all, and the others share what is left
    few = [taken("P0", c) for c in range(1, 4)]
    chosen = choose(few + everything[1000:])
    assert [i for i in chosen.images if i.pose_id == "P0"] == [image for image, _ in few]
    assert MAX_IMAGES - 4 < len(chosen.images) <= MAX_IMAGES


def test_large_grids_and_many_poses_are_bounded_too() -> None:
    chosen = choose([taken("P1", c, points=5000) for c in range(1, 201)])
    assert len(chosen.images) == MAX_POINTS // 5000
    sweep = [taken(f"P{p}", 1) for p in range(1500)]
    chosen = choose(sweep)
    assert len(chosen.images) == MAX_POSES
    assert (chosen.images[0], chosen.images[-1]) == (sweep[0][0], sweep[-1][0])
    visited = [taken(f"Q{p}", c) for p in range(3) for c in (1, 2)]
    chosen = choose(sweep + visited)
    assert {image.measurement_id for image, _ in visited} < {i.measurement_id for i in chosen.images}
    assert len(chosen.images) == MAX_POSES + 3


def test_of_as_many_images_of_two_settings_the_first_are_taken() -> None:
    images = tuple(taken(f"P{p}", 1)[0] for p in range(4))

    def stack(width: int) -> ViewStack:
        return ViewStack(
            width,
            480,
            (BOARD,),
            np.zeros(2, dtype=np.intp),
            np.array([0, 140, 280]),
            np.zeros(280, dtype=np.intp),
            np.zeros(280, dtype=np.intp),
            np.zeros((280, 2)),
            np.ones(280),
            np.zeros((280, 3)),
        )

    views = (
        CameraViews("default", np.arange(2), stack(640)),
        CameraViews("default", np.arange(2, 4), stack(480)),
    )
    selected = select_images(SessionData((BOARD,), ("tgt_1",), images, views))
    assert selected is not None
    (warning,) = selected.warnings
    assert warning.code == "images_of_other_focus_group"
    assert "480 x 480 px, the first of those with the most images" in warning.detail
    assert "640 x 480 px (2)" in warning.detail


def test_a_pose_that_shows_two_targets_counts_for_one() -> None:
    chosen = choose([taken("P1", 1), taken("P1", 2), taken("P1", 3, target=1)])
    assert chosen.pose_ids == ("P1", "P1", None)
    assert chosen.warnings == ["images_of_other_target"]
