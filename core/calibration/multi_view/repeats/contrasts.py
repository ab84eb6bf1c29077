"""Contrasts of residuals that no pose can take up, and how they scatter over the images of one pose.

The residuals of an image are (1 - J G) e, of which the pose has taken its part. A combination Qᵀ of residuals with
QᵀJ = 0 is free of the pose: Qᵀ r = Qᵀ e, whichever points the fit used. What all images of a pose share (the print, the
lens) leaves with their mean. Q are the low modes of the discrete cosine transform over the grid, in u and in v, less
the directions of J: correlated noise that moves a pose is of low frequency, and so are they.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.multi_view.repeat_consistency import is_same_scene
from core.calibration.multi_view.schur_blocks import camera_changes
from core.calibration.multi_view.view_stack import Placements, ViewStack
from core.calibration.residuals import residuals_with_jacobian
from core.calibration.state import SMALLEST_NOISE_PX

MODES = (7, 5)
"""Modes along the longer and the shorter side of the grid."""
MODES_OF_SQUARE = (6, 6)
"""A square grid looks the same when it is turned by a quarter, and so must its modes."""
MIN_CONTRASTS = 20
MIN_SINGULAR_VALUE = 0.1
"""Of the modes less J: below it a mode is the pose's."""

MIN_CAMERA_VALUE = 1e-4
"""Of what a change of the camera does to the points: below it the pose takes all of it up."""


@dataclass(frozen=True, slots=True)
class PoseContrasts:
    """Contrasts of the images of one pose, at the points that all of them use.

    Parameters
    ----------
    images
        Those compared: places in the stack. Images with so few points of the others' that they would cost more of the
        points than they add are not among them.
    basis
        Q, orthonormal over (u, v) and the p points.
    points_px
        Mean over the images.
    relative_variance
        The points' stated variances over their mean.
    values
        Qᵀ (r_j - r̄), px, a row for each image.
    fine
        Squared residuals about the mean that Q does not hold, px², of each image.
    fine_contrasts
        Of how many contrasts `fine` is the sum.
    camera
        Orthonormal directions of contrasts in which `schur_blocks.camera_changes` show.
    """

    images: Int[np.ndarray, " n"]
    basis: Float[np.ndarray, "2 p d"]
    points_px: Float[np.ndarray, "p 2"]
    relative_variance: Float[np.ndarray, " p"]
    values: Float[np.ndarray, "n d"]
    fine: Float[np.ndarray, " n"]
    fine_contrasts: int
    camera: Float[np.ndarray, "d c"]

    @property
    def freedom(self) -> int:
        return len(self.images) - 1

    @property
    def is_exact(self) -> bool:
        """Whether all that differs are rounding errors, as of one image stored many times."""
        return float(np.sum(self.values**2)) <= self.freedom * self.values.shape[1] * SMALLEST_NOISE_PX**2


def camera_share(pose: PoseContrasts) -> float:
    """Return the share that changes of the camera have in the contrasts' variance beyond white noise.

    White noise is what the fine residuals hold: no smooth field and no camera shows in them.
    """
    if pose.fine_contrasts < MIN_CONTRASTS:
        return 1.0  # nothing distinguishes noise from a change of the camera
    white = float(pose.fine.sum()) / pose.fine_contrasts
    whole = float(np.sum(pose.values**2)) - white * pose.values.shape[1]
    of_camera = float(np.sum((pose.values @ pose.camera) ** 2)) - white * pose.camera.shape[1]
    return of_camera / whole if whole > 0.0 else 1.0


def jacobian_of(
    views: ViewStack, placements: Placements, i: int, points: Int[np.ndarray, " p"]
) -> Float[np.ndarray, "q 2 p"]:
    """Return the derivatives of an image's points by the camera's free parameters and the pose."""
    _, J = residuals_with_jacobian(*views.centred(i, points), placements.view(i), placements.free)
    return J


def own_part(
    J: Float[np.ndarray, "q 2 p"], own: Float[np.ndarray, "k q l"] | None, i: int
) -> Float[np.ndarray, "l 2 p"]:
    """Return the derivatives by what an image has of its own, the pose last."""
    return np.asarray(J[-6:] if own is None else np.tensordot(own[i].T, J, axes=1))


def pose_contrasts(
    views: ViewStack,
    placements: Placements,
    residuals: Float[np.ndarray, "2 n"],
    used: Bool[np.ndarray, " n"],
    own: Float[np.ndarray, "k q l"] | None,
    group: Int[np.ndarray, " g"],
) -> PoseContrasts | None:
    """Return the contrasts of the images `group` of one pose and target; None where too few points are common."""
    if len(group) < 2:
        return None
    images, points = common_points(views, used, group)
    if len(images) < 2 or points.shape[1] < MIN_CONTRASTS:
        return None
    first = points[0]
    i = int(images[0])
    whole = jacobian_of(views, placements, i, first)
    J = own_part(whole, own, i)
    modes = _cosine_modes(views.column[first], views.row[first])
    # Q ⊥ J, after J's columns are made orthonormal.
    span = np.linalg.qr((J / np.linalg.norm(J, axis=(1, 2))[:, None, None]).reshape(len(J), -1).T)[0]
    # Eigenvectors, in half of the time of singular ones: none of those kept is near the rounding of their squares.
    modes = modes - span @ (span.T @ modes)
    squares, turns = np.linalg.eigh(modes.T @ modes)
    kept = squares > MIN_SINGULAR_VALUE**2
    Q = modes @ (turns[:, kept] / np.sqrt(squares[kept]))
    if Q.shape[1] < MIN_CONTRASTS:
        return None
    changes = np.tensordot(camera_changes(placements.parameters[i]), whole[: placements.free], axes=1)
    changes = changes.reshape(len(changes), -1)
    shown, size, _ = np.linalg.svd(
        Q.T @ (changes / np.linalg.norm(changes, axis=1)[:, None]).T, full_matrices=False
    )
    # np.take: five times as fast as residuals[:, points].
    deviations = np.take(residuals, points, axis=1).transpose(1, 0, 2).reshape(len(images), -1)
    deviations -= deviations.mean(axis=0)
    deviations -= (deviations @ span) @ span.T
    values = deviations @ Q
    fine = np.einsum("nq,nq->n", deviations, deviations) - np.einsum("nd,nd->n", values, values)
    variance = np.mean(views.standard_uncertainty_px[points] ** 2, axis=0)
    return PoseContrasts(
        images,
        Q.reshape(2, len(first), -1),
        np.take(views.points_px, points, axis=0).mean(axis=0),
        variance / variance.mean(),
        values,
        np.maximum(fine, 0.0),
        2 * len(first) - len(J) - Q.shape[1],
        shown[:, size > MIN_CAMERA_VALUE],
    )


def common_points(
    views: ViewStack, used: Bool[np.ndarray, " n"], group: Int[np.ndarray, " g"]
) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, "m p"]]:
    """Return images of one pose and the points that all of them use, by images and cells.

    Images that miss most points are dropped one after another, as long as contrasts times degrees of freedom grow.
    """
    place = _places(views, used, group)
    order = np.argsort(-np.sum(place >= 0, axis=1), kind="stable")
    place = place[order]
    common = np.logical_and.accumulate(place >= 0, axis=0)
    worth = np.arange(len(group)) * common.sum(axis=1)
    count = int(np.argmax(worth)) + 1
    chosen = np.sort(order[:count])
    return group[chosen], place[np.argsort(order[:count])][:, common[count - 1]]


def _places(
    views: ViewStack, used: Bool[np.ndarray, " n"], group: Int[np.ndarray, " g"]
) -> Int[np.ndarray, "g c"]:
    """Return where the points of images stand, by images and cells that one of them shows, ascending; -1 where an image
    does not use its point.
    """
    if is_same_scene(views, group):
        shown = views.first[group][:, None] + np.argsort(views.cell[views.part(int(group[0]))])
        return np.where(used[shown], shown, -1)
    place = np.full((len(group), views.targets[int(views.target[group[0]])].size), -1)
    for j, i in enumerate(group.tolist()):
        part = views.part(i)
        places = np.arange(part.start, part.stop)[used[part]]
        place[j, views.cell[places]] = places
    return place


def _cosine_modes(column: Int[np.ndarray, " p"], row: Int[np.ndarray, " p"]) -> Float[np.ndarray, "2*p q"]:
    """Return the low modes over the grid's extent, first of u, then of v, each of unit length."""
    columns, rows = int(np.ptp(column)) + 1, int(np.ptp(row)) + 1
    most = MODES_OF_SQUARE if columns == rows else MODES if columns > rows else MODES[::-1]
    x, y = (column - column.min() + 0.5) / columns, (row - row.min() + 0.5) / rows
    along = np.cos(np.pi * x[:, None] * np.arange(min(most[0], columns)))
    across = np.cos(np.pi * y[:, None] * np.arange(min(most[1], rows)))
    modes = (along[:, :, None] * across[:, None, :]).reshape(len(column), -1)
    modes /= np.maximum(np.linalg.norm(modes, axis=0), 1e-12)
    both = np.zeros((2, len(column), 2, modes.shape[1]))
    both[0, :, 0] = both[1, :, 1] = modes
    return both.reshape(2 * len(column), -1)
