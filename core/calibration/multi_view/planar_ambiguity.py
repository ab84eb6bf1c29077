"""Two-fold ambiguity of every pose of a focus group: the better tilt, chosen for all images of a pose together.

Where perspective hardly shows, one image of a pose may fit the mirrored tilt better by chance and the next one the true
one, so that the pose jumps between the two from cycle to cycle. The images of a pose show one tilt: what each says of
the two adds up, Λ = Σ (c_B - c_A)/s², and all are put in the one that is the better by that. What remains undecided,
by the quantile that holds for one image, is no answer.

Most poses cannot be mistaken, and one image of each says so; only the images of the others are looked at one by one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.multi_view.bundle_adjustment import BundleAdjustment, bundle_adjust
from core.calibration.multi_view.view_stack import Placements, ViewStack, groups_of
from core.calibration.planar_ambiguity import SecondPose, is_covered, needed_evidence, second_pose
from core.calibration.priors import Lens
from core.calibration.residuals import View
from core.calibration.state import view_residuals
from core.errors import PoseAmbiguous
from core.numerics import Sharing

CERTAIN_RATIO = 2.0
"""Times the quantile: where a pose's first image is so sure, the others are not looked at."""
ROUNDS = 2
"""Fits after which views still in the wrong minimum are left there: the camera follows the poses a little."""


@dataclass(frozen=True, slots=True)
class PlanarSolutions:
    """The placements with the better tilt of each pose's two, which of them changed, which are ambiguous, and the ratio
    of the lesser to the greater sum of squared residuals of all that were looked at; 0 elsewhere. `evidence` is the √Λ
    of each pose's first image, infinite where it has no second tilt.
    """

    placements: Placements
    changed: Bool[np.ndarray, " m"]
    ambiguous: Bool[np.ndarray, " m"]
    ratio: Float[np.ndarray, " m"]
    evidence: Float[np.ndarray, " m"]


@dataclass(frozen=True, slots=True)
class _Fitted:
    """What is known of fitted views; `variance` is that of a residual."""

    views: ViewStack
    placements: Placements
    residuals: Float[np.ndarray, "2 n"]
    used: Bool[np.ndarray, " n"]
    variance: Float[np.ndarray, " m"]

    def counted(self, i: int) -> Bool[np.ndarray, " p"]:
        """Return which points of a view are compared: those used, or all if no point is used."""
        used = self.used[self.views.part(i)]
        return used if used.any() else np.ones_like(used)

    def second(self, i: int) -> SecondPose | None:
        """Return the other minimum of a view; over all points if no point is used."""
        part, points = self.views.part(i), self.views.view(i)
        used = self.counted(i)
        residuals = self.residuals[:, part][:, used] / points.standard_uncertainty_px[used]
        return second_pose(
            points, self.placements.view(i), used, float(np.sum(residuals**2)), float(self.variance[i])
        )

    def freedom(self, i: int) -> float:
        return 2.0 * float(self.used[self.views.part(i)].sum()) - 6.0


def compare_solutions(
    views: ViewStack,
    labels: Int[np.ndarray, " m"],
    placements: Placements,
    residuals: Float[np.ndarray, "2 n"],
    used: Bool[np.ndarray, " n"],
    variance: Float[np.ndarray, " m"],
    information: Float[np.ndarray, "m 6 6"],
    certain: Bool[np.ndarray, " m"] | None = None,
) -> PlanarSolutions:
    """Compare the two tilts of every label's views, but those `certain` already.

    `residuals` (px) and the points `used` are of the views at their placements, `variance` that of a residual in stated
    uncertainties, `information` (w, d about the points' centroid) that of the poses at unit variance.
    """
    fitted = _Fitted(views, placements, residuals, used, variance)
    rotations, translations = placements.rotations.copy(), placements.translations_mm.copy()
    changed, ambiguous = np.zeros(len(views), dtype=np.bool_), np.zeros(len(views), dtype=np.bool_)
    ratio, evidences = np.zeros(len(views)), np.full(len(views), np.inf)
    counted = views.sums(used.astype(np.float64)) > 0.0
    for pose in groups_of(labels * len(views.targets) + views.target):
        members = pose.tolist()
        if certain is not None and certain[members[0]]:
            continue
        first = fitted.second(members[0])
        evidences[pose] = np.inf if first is None else first.evidence
        if first is None or first.evidence >= CERTAIN_RATIO * needed_evidence(fitted.freedom(members[0])):
            # A view of which nothing counts may be where it is for the wrong tilt's sake.
            members = pose[~counted[pose]].tolist()
        seconds = {i: other for i in members if (other := fitted.second(i)) is not None}
        if not seconds:
            continue
        for i, other in seconds.items():
            ratio[i] = other.ratio
        turned, evidence = _together(fitted, seconds)
        for i in turned:
            rotations[i], translations[i] = seconds[i].view.rotation, seconds[i].view.translation_mm
            changed[i] = True
        if evidence < needed_evidence(float(np.mean([fitted.freedom(i) for i in seconds]))):
            for i, other in seconds.items():
                ambiguous[i] = not is_covered(other, placements.view(i), information[i] / variance[i])
    return PlanarSolutions(
        Placements(placements.parameters, rotations, translations), changed, ambiguous, ratio, evidences
    )


def _together(fitted: _Fitted, seconds: dict[int, SecondPose]) -> tuple[list[int], float]:
    """Return which views of one pose are to be turned to their other tilt, and √Λ of all together for what results:
    the gain of their mean residuals, over the variance that these have.
    """
    leader = next(iter(seconds))
    normals = (fitted.placements.rotations[leader][:, 2], seconds[leader].view.rotation[:, 2])
    means = np.zeros((2, 2, int(fitted.views.cell.max()) + 1))  # of the residuals in either tilt, by cell
    weight = np.zeros(means.shape[2])
    own = 0.0
    in_first: dict[int, bool] = {}
    for i, other in seconds.items():
        normal = fitted.placements.rotations[i][:, 2]
        in_first[i] = float(normal @ normals[0]) >= float(normal @ normals[1])
        cells, here, there, w = _both(fitted, i, other)
        means[:, :, cells] += w * np.stack([here, there] if in_first[i] else [there, here])
        weight[cells] += w
        own += min(float(np.sum(w * here**2)), float(np.sum(w * there**2))) / other.variance
    seen = weight > 0.0
    # Σ over cells of (the cell's weight) x (mean residual)²: as one image's sum, of noise s² where all is independent.
    sums = np.sum(means[:, :, seen] ** 2 / weight[seen], axis=(1, 2))
    turned = [i for i, first in in_first.items() if first != bool(sums[1] >= sums[0])]
    variance = float(np.mean([other.variance for other in seconds.values()]))
    # Of n images that have nothing in common the better sum is 1/n of all squares; common is what is beyond that.
    common = max(float(np.min(sums)) / variance * len(seconds) / max(own, 1e-300), 1.0)
    return turned, float(np.sqrt(abs(sums[1] - sums[0]) / (variance * common)))


def _both(
    fitted: _Fitted, i: int, other: SecondPose
) -> tuple[
    Int[np.ndarray, " p"], Float[np.ndarray, "2 p"], Float[np.ndarray, "2 p"], Float[np.ndarray, " p"]
]:
    """Return the cells of a view's points, the residuals (px) in its tilt and in the other, and the points' weights."""
    part, points = fitted.views.part(i), fitted.views.view(i)
    there, _ = view_residuals(points, free=False)(other.view)
    used = fitted.counted(i)
    return (
        fitted.views.cell[part][used],
        fitted.residuals[:, part][:, used],
        there[:, used],
        fitted.views.weight[part][used],
    )


def select_solutions(
    views: ViewStack,
    shared: BundleAdjustment,
    sharing: Sharing,
    lens: Lens | None,
    labels: Int[np.ndarray, " m"],
) -> tuple[BundleAdjustment, Float[np.ndarray, " m"]]:
    """Return the fit with every pose in the better of its two tilts, and how sure of it each pose's first image is: √Λ
    at the fit's own scale; 0 where that was not looked at.
    """
    evidence = np.zeros(len(views))
    for _ in range(ROUNDS):
        if not shared.converged:
            break
        at = shared.at
        tilts = compare_solutions(
            views,
            labels,
            at.placements,
            at.residuals,
            shared.used,
            np.full(len(views), shared.scale**2),
            at.of_poses,
        )
        if not tilts.changed.any():
            evidence = tilts.evidence
            break
        shared = bundle_adjust(views, tilts.placements, sharing, lens=lens, repeats=labels)
    return shared, evidence


def pose_ambiguity_failure(ratio: float, view: View) -> PoseAmbiguous:
    """Return the failure of a view whose two possible tilts cannot be distinguished."""
    tilt = float(np.degrees(np.arccos(np.clip(view.rotation[2, 2], -1.0, 1.0))))
    return PoseAmbiguous(
        f"The board, tilted by {tilt:.0f}°, may as well be tilted the opposite way: the two poses leave squared "
        f"residuals of the ratio {ratio:.2f}, and the images of this pose together do not determine which is true."
    )
