"""One labelling for every board that looks the same when turned, over all images of a session.

The labelling is chosen in two steps. Before the estimate, the images of one pose get the same labelling, by where their
points lie in the image; the consistency of repeats is then judged point by point. After the camera is estimated, all
poses get the same labelling by their rotations (`core.calibration.multi_view.board_symmetry`). Both steps add up to a
number of quarter turns of each image, which is kept with the estimate.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration import (
    CommonFit,
    GroupEstimate,
    LensEvidence,
    ViewStack,
    nearest_turn,
    quarter_turns,
    resolve_symmetry,
    symmetry_rotations,
    turned_cells,
)
from core.errors import Advisory, listed
from core.session.model import CameraViews, ImageObservation, SessionData, natural

SAME_DEG = 1.0
"""Joint angles of an image that differ by less from the pose's are those of the pose."""
MAX_END_SHIFT = 0.25
"""Of the distance of a board's first and last point: images whose ends lie nearer have the same labelling."""


@dataclass(frozen=True)
class LabelledGroup:
    """A focus group's images under one labelling of each target; rows run over the images that are estimated.

    `images` are their places in the session, `shows_origin` marks labellings that are known to be the board's own,
    `evidence` is that against Brown's lens model.
    """

    name: str
    images: Int[np.ndarray, " k"]
    shows_origin: Bool[np.ndarray, " k"]
    estimate: GroupEstimate
    views: ViewStack
    quarters: Int[np.ndarray, " k"]
    evidence: LensEvidence | None = None


@dataclass(frozen=True)
class SessionLabelling:
    """The groups under one labelling; the images, by measurement, that no labelling brings near the others of their
    pose; what to know of it all.
    """

    groups: list[LabelledGroup]
    unclear: frozenset[str]
    warnings: list[Advisory]


def shows_origin(image: ImageObservation) -> bool:
    """Return whether an image shows which end of the board is which."""
    return image.labelling == "absolute"


def label_repeats(
    group: CameraViews, images: Sequence[ImageObservation]
) -> tuple[ViewStack, Int[np.ndarray, " k"], Bool[np.ndarray, " k"]]:
    """Give each pose's images of a target one labelling: that of an image that shows the origin, else of the fullest.

    Returns the points so labelled, each image's quarter turns, and whether its labelling is known to be the board's.
    """
    views = group.views
    quarters = np.zeros(len(views), dtype=np.intp)
    known = np.array([shows_origin(images[i]) for i in group.images])
    visits: dict[Hashable, list[int]] = {}
    turning = np.array([len(quarter_turns(target)) > 1 for target in views.targets])[views.target]
    for k in np.flatnonzero(turning).tolist():
        image = images[group.images[k]]
        visits.setdefault((image.pose_id, image.target), []).append(k)
    for members in visits.values():
        if known[members].all():
            continue
        first = min(members, key=lambda k: (not known[k], -int(views.counts[k]), k))
        others = np.array([k for k in members if not known[k] and k != first], dtype=np.intp)
        agree = _ends_agree(views, first, others)
        known[others[agree]] = known[first]
        for k in others[~agree].tolist():
            turn = nearest_turn(views, first, k)
            if turn is not None:
                quarters[k], known[k] = turn, known[first]
    return relabelled(views, quarters)[0], quarters, known


def relabelled(views: ViewStack, quarters: Int[np.ndarray, " k"]) -> tuple[ViewStack, Int[np.ndarray, " n"]]:
    """Return the views with the points of each image under the labels that its turned target frame gives them, and
    which of the given points each one is.

    With T_image_labelled the turn of `symmetry_rotations`, points are X_labelled = T_image_labelled⁻¹ X_image; within
    an image they are listed row by row.
    """
    turned = np.flatnonzero(quarters)
    order = np.arange(len(views.column))
    if not len(turned):
        return views, order
    column, row, points_target = views.column.copy(), views.row.copy(), views.points_target.copy()
    for k in turned.tolist():
        at, target, quarter = views.part(k), views.targets[int(views.target[k])], int(quarters[k])
        new = turned_cells(target, column[at], row[at], -quarter % 4)
        by_row = np.lexsort(new)
        order[at] = at.start + by_row
        # What a board departs from the ideal grid turns with it.
        departure = points_target[at] - target.points_target(column[at], row[at])
        turn = symmetry_rotations(target)[quarter_turns(target).index(quarter)]
        column[at], row[at] = new[0][by_row], new[1][by_row]
        ideal = target.points_target(column[at], row[at])
        points_target[at] = ideal + (departure @ turn[:3, :3])[by_row]
    labelled = replace(
        views,
        column=column,
        row=row,
        points_px=views.points_px[order],
        standard_uncertainty_px=views.standard_uncertainty_px[order],
        points_target=points_target,
    )
    return labelled, order


def label_poses(data: SessionData, groups: Sequence[LabelledGroup]) -> SessionLabelling:
    """Choose one labelling for every target over all its images, where images that show its origin do not fix it."""
    labelled = list(groups)
    ambiguous: set[str] = set()
    contradicting: set[str] = set()
    unclear: set[str] = set()
    guessed = False
    commanded: dict[Hashable, Float[np.ndarray, "3 3"]] = {
        # Of a fixed camera R_target_camera = R_target_flange R_flange_base R_base_camera.
        pose_id: rotation if data.camera_mount == "robot" else rotation.T
        for pose_id, pose in data.commanded.items()
        if (rotation := pose.rotation()) is not None
    }
    for place, target in enumerate(data.targets):
        turns = symmetry_rotations(target)
        shown = sorted(
            (int(i), g, k)
            for g, group in enumerate(groups)
            for k, i in enumerate(group.images)
            if data.images[i].target == place
        )
        if not shown or (len(turns) == 1 and not commanded):
            continue
        images = [data.images[i] for i, _, _ in shown]
        labels = [_label(image, data) for image in images]
        rotations = np.array([groups[g].estimate.rotations[k] for _, g, k in shown])
        known = [bool(groups[g].shows_origin[k]) for _, g, k in shown]
        chosen = resolve_symmetry(rotations, labels, turns, commanded, known)
        of_group = np.array([g for _, g, _ in shown])
        rows = np.array([k for _, _, k in shown])
        for turn, quarter in enumerate(quarter_turns(target)):
            for g in range(len(labelled)) if turn else ():  # the first turn is the identity
                turned = rows[(of_group == g) & (chosen.turns == turn)]
                if len(turned):
                    labelled[g] = _turned(labelled[g], turned, quarter, turns[turn])
        unclear |= {
            image.measurement_id for image, one in zip(images, chosen.unclear.tolist(), strict=True) if one
        }
        contradicting |= {_pose_id(label) for label in chosen.contradicting}
        if not (chosen.settled or all(known)) and len(set(labels)) > 1:
            guessed = True
            ambiguous |= {_pose_id(label) for label in chosen.ambiguous}
    warnings = [_ambiguous(sorted(ambiguous, key=natural))] if guessed else []
    if unclear:
        warnings.append(_unclear([i.pose_id for i in data.images if i.measurement_id in unclear]))
    if contradicting:
        warnings.append(_contradicting(contradicting))
    return SessionLabelling(labelled, frozenset(unclear), warnings)


def _ends_agree(views: ViewStack, first: int, others: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Return which images have the first and last point of image `first`, near the same places."""
    chosen = np.array([first, *others])
    ends = np.stack([views.first[chosen], views.first[chosen + 1] - 1], axis=1)
    cells, px = views.cell[ends], views.points_px[ends]
    near = MAX_END_SHIFT * float(np.linalg.norm(px[0, 1] - px[0, 0]))
    return np.asarray(
        np.all(cells[1:] == cells[0], axis=1) & np.all(np.linalg.norm(px[1:] - px[0], axis=2) < near, axis=1)
    )


def _turned(
    group: LabelledGroup, rows: Int[np.ndarray, " r"], quarter: int, turn: Float[np.ndarray, "4 4"]
) -> LabelledGroup:
    """Return the group with some images' target frame turned: T_target_camera becomes turn⁻¹ T_target_camera."""
    back = turn[:3, :3].T
    both = np.zeros((6, 6))
    both[:3, :3] = both[3:, 3:] = back
    estimate = group.estimate
    positions, rotations = estimate.positions_mm.copy(), estimate.rotations.copy()
    covariance, scatter, common = estimate.covariance.copy(), estimate.scatter.copy(), estimate.common.copy()
    positions[rows] = (positions[rows] - turn[:3, 3]) @ back.T
    rotations[rows] = back @ rotations[rows]
    covariance[rows] = both @ covariance[rows] @ both.T
    scatter[rows] = both @ scatter[rows] @ both.T
    common[rows] = both @ common[rows]
    step = np.zeros(len(group.quarters), dtype=np.intp)
    step[rows] = quarter
    return replace(
        group,
        estimate=replace(
            estimate,
            positions_mm=positions,
            rotations=rotations,
            covariance=covariance,
            scatter=scatter,
            common=common,
            fit=None if estimate.fit is None else _turned_fit(estimate.fit, step),
        ),
        views=relabelled(group.views, step)[0],
        quarters=(group.quarters + step) % 4,
    )


def _turned_fit(fit: CommonFit, quarters: Int[np.ndarray, " k"]) -> CommonFit:
    """Return the fit with some images' target frame turned; the centroid of their points stays where it is."""
    views, order = relabelled(fit.views, quarters)
    rotations = fit.placements.rotations.copy()
    for k in np.flatnonzero(quarters).tolist():
        target = views.targets[int(views.target[k])]
        turn = symmetry_rotations(target)[quarter_turns(target).index(int(quarters[k]))]
        rotations[k] = rotations[k] @ turn[:3, :3]
    return replace(
        fit,
        views=views,
        used=fit.used[order],
        placements=replace(fit.placements, rotations=rotations),
        residuals=fit.residuals[:, order],
    )


def _label(image: ImageObservation, data: SessionData) -> Hashable:
    """Return what images of one orientation have in common: the pose; with joint angles of their own, which override
    the pose's, these too, unless they are those that were commanded.
    """
    own, commanded = image.joint_angles_deg, data.commanded.get(image.pose_id)
    if own is None:
        return image.pose_id
    if commanded is not None and commanded.roll_deg is not None:
        joints = commanded.joint_angles_deg
        if joints is None or (
            len(joints) == len(own) and max(abs(a - b) for a, b in zip(own, joints, strict=True)) < SAME_DEG
        ):
            return image.pose_id
    return (image.pose_id, *(round(angle) for angle in own))


def _pose_id(label: Hashable) -> str:
    return str(label[0]) if isinstance(label, tuple) else str(label)


def _poses(pose_ids: Iterable[str]) -> str:
    return listed(sorted(set(pose_ids), key=natural))


def _ambiguous(pose_ids: Sequence[str]) -> Advisory:
    uncertain = f" Uncertain: {_poses(pose_ids)}." if pose_ids else ""
    return Advisory(
        "board_symmetry_unresolved",
        "The board looks the same when turned; it was labelled so that the camera turns least between poses. "
        f"Repeatability does not depend on it, positions of poses against one another do.{uncertain}",
        "State the poses' commanded orientations, or use a board whose columns and rows have an odd sum, a ChArUco "
        "board, or marked squares.",
    )


def _unclear(pose_ids: Sequence[str]) -> Advisory:
    return Advisory(
        "orientation_inconsistent",
        f"{len(pose_ids)} images of a board that looks the same when turned show another orientation than the first of "
        f"their pose, however it is labelled, and no figure of a pose holds them: {_poses(pose_ids)}.",
        "Check that the images carry the tag of the pose they were taken at.",
    )


def _contradicting(pose_ids: Iterable[str]) -> Advisory:
    return Advisory(
        "commanded_pose_inconsistent",
        f"Commanded and measured orientations contradict each other, however the board is labelled: "
        f"{_poses(pose_ids)}.",
        "Check these poses' roll_deg, pitch_deg and yaw_deg (R = Rz(yaw) Ry(pitch) Rx(roll)) or joint angles, and that "
        "their images carry the right tag.",
    )
