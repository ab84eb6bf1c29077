"""The hash of an analysis' inputs, and stored grid points."""

from __future__ import annotations

import dataclasses

import numpy as np

from app.analyses.inputs.snapshot import Snapshot, StoredImage, StoredPose
from app.records.codec import decode_stack, encode_refused
from app.records.outcome import Provenance
from core.session import ImageObservation
from core.targets.specification import TargetSpec
from tests.support.sessions.stored_sessions import BOARD, HEIGHT, WIDTH, draw_board_pose, look

SEEN = ImageObservation("mea_1", "P1", 1, "0" * 64, 0, "default", None, 640, 480)
IMAGE = StoredImage(SEEN, 45 * 54, "0.1.0")
SNAPSHOT = Snapshot("ses_1", ("tgt_1",), ({"kind": "chessboard"},), None, None, {}, (IMAGE,), 0)


def test_the_hash_holds_no_ids() -> None:
    settings = {"estimator": "pooled"}
    renamed = dataclasses.replace(
        SNAPSHOT,
        session_id="ses_2",
        target_ids=("tgt_2",),
        images=(dataclasses.replace(IMAGE, observation=dataclasses.replace(SEEN, measurement_id="mea_2")),),
        pending=3,
    )
    assert renamed.inputs_sha256("intrinsics", settings) == SNAPSHOT.inputs_sha256("intrinsics", settings)
    for analysis, other in (("repeatability", settings), ("intrinsics", {"estimator": "given"})):
        assert SNAPSHOT.inputs_sha256(analysis, other) != SNAPSHOT.inputs_sha256("intrinsics", settings)


def test_the_hash_is_over_the_mount_of_a_fixed_camera_alone() -> None:
    settings = {"estimator": "pooled"}
    fixed = dataclasses.replace(SNAPSHOT, camera_mount="fixed")
    assert fixed.inputs_sha256("hand_eye", settings) != SNAPSHOT.inputs_sha256("hand_eye", settings)
    # Another instrument's poses have no mount.
    readings = (StoredPose("mps_1", "P1", 1, "0" * 64),)
    measured, of_fixed = (dataclasses.replace(one, images=(), measured=readings) for one in (SNAPSHOT, fixed))
    assert of_fixed.inputs_sha256("dh", settings) == measured.inputs_sha256("dh", settings)


def test_the_hash_is_over_what_analyses_say_of_a_refused_image() -> None:
    """The reason is in their documents; in another session its targets have other ids."""
    settings = {"estimator": "pooled"}

    def refused(detail: str, target_id: str = "tgt_1") -> str:
        seen = dataclasses.replace(SEEN, failure_code="target_not_found", failure_detail=detail)
        image = dataclasses.replace(IMAGE, observation=seen)
        snapshot = dataclasses.replace(SNAPSHOT, target_ids=(target_id,), images=(image,))
        return snapshot.inputs_sha256("intrinsics", settings)

    assert refused("Looked for: tgt_1.") == refused("Looked for: tgt_2.", "tgt_2")
    assert refused("Looked for: tgt_1.") != refused("Looked for it for 60 s.")


def test_stored_points_of_many_images_are_decoded_at_once() -> None:
    boards = [BOARD, TargetSpec("asymmetric_circles", 4, 6, 7.0)]
    rng = np.random.default_rng(1)
    shown = [0, 1, 0]
    views = [look(rng, draw_board_pose(rng, 30.0, boards[k]), board=boards[k]) for k in shown]
    stored = [encode_refused(view, Provenance("0.1.0", "0" * 64, {}))["points"] for view in views]
    stack = decode_stack(stored, boards, shown, WIDTH, HEIGHT)
    assert stack.targets == tuple(boards)
    for k, view in enumerate(views):
        assert stack.view(k) == view
        np.testing.assert_array_equal(stack.view(k).points_target, view.points_target)
        np.testing.assert_array_equal(stack.view(k).standard_uncertainty_px, view.standard_uncertainty_px)
