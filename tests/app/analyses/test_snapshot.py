"""The fixed order of inputs, and what is too much."""

from __future__ import annotations

import dataclasses
import math
import random

import numpy as np
import pytest

from app.records.codec import Provenance, decode_points, decode_stack, encode_refused
from app.services.analyses.estimation import POINTS_AT_MOST, estimate_session
from app.services.analyses.outcome import CannotAnalyse
from app.services.analyses.snapshot import Image, Snapshot, natural
from core.simulation.views import draw_pose
from core.targets.specification import TargetSpec
from tests.app.analyses.conftest import BOARD, CAMERA, HEIGHT, WIDTH, look

IMAGE = Image("mea_1", "P1", 1, "0" * 64, 0, "default", None, 640, 480, None, None, 45 * 54, "0.1.0")
SNAPSHOT = Snapshot("ses_1", ("tgt_1",), ({"kind": "chessboard"},), None, None, {}, (IMAGE,), 0)


def test_poses_are_sorted_as_people_count() -> None:
    names = ["1", "2", "10", "10.1", "A", "P1", "P1.2", "P1.10", "P01", "P2", "P2b", "P10", "a"]
    order = sorted(names, key=natural)
    assert sorted(random.Random(1).sample(names, len(names)), key=natural) == order
    assert len({natural(name) for name in names}) == len(names)  # P1 and P01 are one number and two poses
    for before, after in (
        ("1", "2"),
        ("2", "10"),
        ("P2", "P10"),
        ("P1.2", "P1.10"),
        ("P1", "P2b"),
        ("P01", "P2"),
    ):
        assert order.index(before) < order.index(after)


def test_the_hash_holds_no_ids() -> None:
    settings = {"estimator": "pooled"}
    renamed = dataclasses.replace(
        SNAPSHOT,
        session_id="ses_2",
        target_ids=("tgt_2",),
        images=(dataclasses.replace(IMAGE, measurement_id="mea_2"),),
        pending=3,
    )
    assert renamed.inputs_sha256("intrinsics", settings) == SNAPSHOT.inputs_sha256("intrinsics", settings)
    for analysis, other in (("repeatability", settings), ("intrinsics", {"estimator": "given"})):
        assert SNAPSHOT.inputs_sha256(analysis, other) != SNAPSHOT.inputs_sha256("intrinsics", settings)


def test_more_than_memory_holds_is_refused() -> None:
    large = dataclasses.replace(IMAGE, point_bytes=45 * (POINTS_AT_MOST + 1))
    with pytest.raises(CannotAnalyse) as refusal:
        estimate_session(dataclasses.replace(SNAPSHOT, images=(large,)), {}, "pooled")
    assert refusal.value.refused.code == "too_many_measurements"
    assert refusal.value.refused.advice


def test_stored_points_of_many_images_are_decoded_at_once() -> None:
    boards = [BOARD, TargetSpec("asymmetric_circles", 4, 6, 7.0)]
    rng = np.random.default_rng(1)
    shown = [0, 1, 0]
    views = [
        look(rng, draw_pose(rng, boards[k], CAMERA, WIDTH, math.radians(30.0)), board=boards[k])
        for k in shown
    ]
    stored = [encode_refused(view, Provenance("0.1.0", "0" * 64, {}))["points"] for view in views]
    stack = decode_stack(stored, boards, shown, WIDTH, HEIGHT)
    assert stack.targets == tuple(boards)
    for k, (view, points) in enumerate(zip(views, stored, strict=True)):
        one = decode_points(points, [], boards[shown[k]], WIDTH, HEIGHT)
        assert stack.view(k) == one == view
        np.testing.assert_array_equal(stack.view(k).points_target, one.points_target)
        np.testing.assert_array_equal(stack.view(k).standard_uncertainty_px, one.standard_uncertainty_px)
