"""Where the camera was in every image of a focus group, by any of five estimators on the same grid points.

- `pooled`: all images share one camera; the default, since repeatability needs constant intrinsics, not correct ones.
- `pooled_free_focal`: all but the focal length is shared, for a lens that refocuses between images.
- `per_image`: every image by itself, with weak priors (`single_image`).
- `per_image_fixed_pp`: every image by itself with the principal point held (`fixed_centre`).
- `given`: the camera is known.

Two covariances come with every pose. `covariance` is that of the pose itself. `scatter` is that of the differences
between images of one pose taken by a camera at rest: what is common to the images (the shared camera, what priors pull
all images to, the print's scale) is not in it. Its noise scale comes from the residuals of images of one pose about
their mean where there are such images: what a bowed print or a lens beyond the model leaves in
them is the same in all, makes no scatter, and must not be taken for noise. It may cost a point its place, then in all
images of the pose (`inliers`).
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.fixed_centre import TO_FULL_STEP, fit_fixed_centre
from core.calibration.group_starts import Alike, find_alike, placed, placed_before
from core.calibration.model import RADIAL_PRIORS, SMALLEST_NOISE_PX, Lens, camera_prior, centred, image_centre
from core.calibration.same_points import fit_again, points_in_common
from core.calibration.shared_lens import (
    FREE_FOCAL,
    KNOWN,
    TIED,
    Linearised,
    Placement,
    SharedLens,
    coordinates,
    fit_shared_lens,
    linearise,
)
from core.calibration.single_image import FOCAL_GATE, assumed_focals, calibrate_points, plausible_start
from core.calibration.validity import check_camera
from core.calibration.view_doubt import (
    disagreement,
    in_target_frame,
    pose_covariances,
    repeated_scales,
    transformed,
)
from core.camera import Camera
from core.errors import (
    DegenerateGeometry,
    EstimationError,
    FocalNotObservable,
    GridposeError,
    InvalidArgument,
    NotConverged,
)
from core.targets.specification import GridPoints, TargetSpec

MANY = 200
"""Views from which on a part of them is fitted first."""
ESTIMATORS = ("pooled", "pooled_free_focal", "per_image", "per_image_fixed_pp", "given")


@dataclass(frozen=True, slots=True)
class GroupEstimate:
    """What the images of one focus group amount to; arrays run over the k images that were estimated.

    Parameters
    ----------
    images
        Which of the views given they are, ascending; the others are in `failures`, with the reason.
    camera, camera_covariance
        The common camera, or with estimators that have none the mean over the images with the mean covariance (what
        priors leave of an image's doubt does not average out); order of `CAMERA_PARAMETERS`.
    positions_mm, rotations
        The camera in the target frame.
    covariance, scatter
        x, y, z (mm), then a small rotation w with R_true = exp(w) R, in the target frame; see the module.
    common
        What one standard uncertainty of each error that all images share does to their poses: eight of the shared
        camera, one of the print's scale. `covariance` is the image's own and common commonᵀ.
    reduced_chi2
        Squared residuals over the points' stated uncertainties, per degree of freedom.
    disagreement
        How much better the images would be explained if each had a camera of its own, over what chance would make of
        it: 1 where one camera explains all. None where nothing is shared or there is one image only.
    """

    estimator: str
    images: Int[np.ndarray, " k"]
    failures: tuple[tuple[int, GridposeError], ...]
    camera: Camera
    camera_covariance: Float[np.ndarray, "9 9"]
    cameras: Float[np.ndarray, "k 9"]
    positions_mm: Float[np.ndarray, "k 3"]
    rotations: Float[np.ndarray, "k 3 3"]
    covariance: Float[np.ndarray, "k 6 6"]
    scatter: Float[np.ndarray, "k 6 6"]
    common: Float[np.ndarray, "k 6 9"]
    rms_px: Float[np.ndarray, " k"]
    reduced_chi2: float
    disagreement: float | None


@dataclass(frozen=True, slots=True)
class _Fitted:
    """The views that could be fitted, at their placements, before their doubt is known."""

    images: list[int]
    at: Linearised
    used: tuple[Bool[np.ndarray, " _"], ...]
    shared: SharedLens | None

    @property
    def placements(self) -> tuple[Placement, ...]:
        return self.at.placements


def estimate_group(
    views: Sequence[GridPoints],
    estimator: str,
    *,
    lens: Lens | None = None,
    intrinsics: Camera | None = None,
    repeats: Sequence[Hashable] | None = None,
) -> GroupEstimate:
    """Estimate the camera's pose in every view.

    Parameters
    ----------
    views
        Images of one size, taken with one setting of lens and camera.
    lens
        A 5 % prior on the focal length.
    intrinsics
        The camera of `given`; its principal point is the one held by `per_image_fixed_pp`.
    repeats
        A label for each view: views with the same one show the same pose of the robot.

    Raises InvalidArgument for no views, mixed image sizes, an unknown estimator or `given` without intrinsics;
    EstimationError where no view can be estimated or, with a shared camera, the focal length is not determined.
    """
    if not views:
        raise InvalidArgument("At least one view is needed.")
    if len({(v.image_width_px, v.image_height_px) for v in views}) > 1:
        raise InvalidArgument(
            "The images of one focus group have different sizes.",
            "Give every camera setting a focus group of its own.",
        )
    # The print's scale is common to all images; it is added to the covariance at the end.
    plain = _located(views)
    labels = list(range(len(views))) if repeats is None else list(repeats)
    failures: dict[int, GridposeError] = {}
    if estimator in ("pooled", "pooled_free_focal"):
        fitted = _fit_pooled(plain, labels, estimator == "pooled_free_focal", lens, failures)
    elif estimator == "given":
        if intrinsics is None:
            raise InvalidArgument("The estimator `given` needs intrinsics.")
        fitted = _fit_given(plain, labels, intrinsics, failures)
    elif estimator in ("per_image", "per_image_fixed_pp"):
        fitted = _fit_each(plain, labels, estimator, lens, intrinsics, failures)
    else:
        raise InvalidArgument(f"Unknown estimator {estimator!r}.", f"Use one of {', '.join(ESTIMATORS)}.")
    return _with_doubt(views, plain, labels, fitted, estimator, lens, failures)


def _located(views: Sequence[GridPoints]) -> list[GridPoints]:
    """Return the views without the doubt of their prints' scale, places in the target frame computed once a grid."""
    places: dict[tuple[TargetSpec, bytes, bytes], Float[np.ndarray, "n 3"]] = {}
    targets: dict[TargetSpec, TargetSpec] = {}
    located = []
    for v in views:
        key = (v.target, v.column.tobytes(), v.row.tobytes())
        if v.measured_points_target is None and key not in places:
            places[key] = v.points_target
        if v.target not in targets:
            targets[v.target] = replace(v.target, pitch_standard_uncertainty_mm=None)
        measured = places[key] if v.measured_points_target is None else v.measured_points_target
        located.append(replace(v, target=targets[v.target], measured_points_target=measured))
    return located


def _fit_pooled(
    views: Sequence[GridPoints],
    labels: Sequence[Hashable],
    free_focal: bool,
    lens: Lens | None,
    failures: dict[int, GridposeError],
) -> _Fitted:
    alike = find_alike(views, labels, least=6)
    failures |= alike.failures
    if not alike.usable:
        raise _first(failures)
    chosen = [views[i] for i in alike.usable]
    repeats = [labels[i] for i in alike.usable]
    starts = [plausible_start(H, views[i]) for i, H in alike.homographies.items()]
    found = [start.camera.fx_px for start in starts if start is not None]
    focals = [float(np.median(found))] if found else assumed_focals(chosen[0], lens)
    fits = []
    for focal in focals:
        camera = Camera(focal, focal, *image_centre(chosen[0]))
        of_leader = {i: placed(H, views[i], camera) for i, H in alike.homographies.items()}
        of_leader = _fit_part(views, alike, of_leader, lens)
        start = [of_leader[alike.leader[i]] for i in alike.usable]
        fits.append(fit_shared_lens(chosen, start, TIED, lens=lens, repeats=repeats))
    shared = min(fits, key=lambda f: (not f.converged, -int(f.kept.sum()), f.scale))
    _check_focal(shared)
    if free_focal:
        shared = fit_shared_lens(chosen, shared.at.placements, FREE_FOCAL, lens=lens, repeats=repeats)
    if not shared.converged:
        raise NotConverged(
            "No common camera explains the images.",
            "Check that all images of the focus group show the session's targets, taken with one camera setting.",
        )
    return _kept(alike.usable, shared, failures)


def _fit_part(
    views: Sequence[GridPoints], alike: Alike, of_leader: dict[int, Placement], lens: Lens | None
) -> dict[int, Placement]:
    """Return placements of the leaders, fitted among themselves where they are few among many: the fit of all, which
    begins there, then is at its end in a step or two.
    """
    leaders = list(of_leader)
    if len(alike.usable) < MANY or len(leaders) > len(alike.usable) // 4:
        return of_leader
    part = fit_shared_lens([views[i] for i in leaders], [of_leader[i] for i in leaders], TIED, lens=lens)
    if not (part.converged and part.kept.all()):
        return of_leader
    return dict(zip(leaders, part.at.placements, strict=True))


def _check_focal(shared: SharedLens) -> None:
    """Raise FocalNotObservable where all views together leave the focal length open."""
    covariance = shared.covariance
    u = math.sqrt(0.25 * float(covariance[0, 0] + 2.0 * covariance[0, 1] + covariance[1, 1]))
    focal = 0.5 * float(sum(shared.at.placements[0].parameters[:2]))
    if u > FOCAL_GATE * focal:
        raise FocalNotObservable(
            f"Together the images leave the focal length uncertain by {100.0 * u / focal:.1f} %; the limit is "
            f"{100.0 * FOCAL_GATE:g} %.",
            "Add images with the target tilted by 15° or more, or give the session intrinsics and use estimator=given.",
        )


def _fit_given(
    views: Sequence[GridPoints],
    labels: Sequence[Hashable],
    camera: Camera,
    failures: dict[int, GridposeError],
) -> _Fitted:
    check_camera(camera, views[0])
    alike = find_alike(views, labels, least=5)
    failures |= alike.failures
    of_leader: dict[int, Placement] = {}
    for i in alike.homographies:
        try:
            of_leader[i] = placed_before(camera, views[i])
        except EstimationError as failure:
            failures |= {k: failure for k in alike.usable if alike.leader[k] == i}
    usable = [i for i in alike.usable if alike.leader[i] in of_leader]
    if not usable:
        raise _first(failures)
    start = [of_leader[alike.leader[i]] for i in usable]
    repeats = [labels[i] for i in usable]
    return _kept(usable, fit_shared_lens([views[i] for i in usable], start, KNOWN, repeats=repeats), failures)


def _fit_each(
    views: Sequence[GridPoints],
    labels: Sequence[Hashable],
    estimator: str,
    lens: Lens | None,
    intrinsics: Camera | None,
    failures: dict[int, GridposeError],
) -> _Fitted:
    images, placements, used, lenses = [], [], [], []
    for i, points in enumerate(views):
        try:
            if estimator == "per_image":
                found = calibrate_points(points, lens=lens)
                rotation = found.T_camera_target[:3, :3]
                centroid = rotation @ centred(points)[1] + found.T_camera_target[:3, 3]
                placement, kept = Placement(found.camera.as_array(), rotation, centroid), found.used
                contradicted = any(w.code == "lens_prior_contradicted" for w in found.warnings)
            else:
                contradicted = False
                placement, kept = _fixed_centre(points, lens, intrinsics)
        except GridposeError as failure:
            failures[i] = failure
            continue
        images.append(i)
        placements.append(placement)
        used.append(kept)
        lenses.append(None if contradicted else lens)
    if not images:
        raise _first(failures)
    chosen = [views[i] for i in images]
    at = linearise(chosen, placements, used)
    common = points_in_common(chosen, at, [labels[i] for i in images])
    again = [k for k in range(len(images)) if not np.array_equal(used[k], common[k])]
    if not again:
        return _Fitted(images, at, tuple(used), None)
    for k in again:
        try:
            placements[k] = fit_again(
                chosen[k],
                placements[k],
                common[k],
                centre_held=estimator == "per_image_fixed_pp",
                lens=lenses[k],
            )
        except NotConverged as failure:
            failures[images[k]] = failure
    left = [k for k, i in enumerate(images) if i not in failures]
    if not left:
        raise _first(failures)
    used = [common[k] for k in left]
    at = linearise([chosen[k] for k in left], [placements[k] for k in left], used)
    return _Fitted([images[k] for k in left], at, tuple(used), None)


def _fixed_centre(
    points: GridPoints, lens: Lens | None, intrinsics: Camera | None
) -> tuple[Placement, Bool[np.ndarray, " n"]]:
    centre = image_centre(points) if intrinsics is None else (intrinsics.cx_px, intrinsics.cy_px)
    result = fit_fixed_centre(points, centre, lens)
    state = result.state
    u = math.sqrt(max(float(result.covariance[0, 0]), 0.0)) / float(state.parameters[0])
    if u > FOCAL_GATE:
        raise FocalNotObservable(
            f"The focal length is uncertain by {100.0 * u:.1f} % in this view; the limit is {100.0 * FOCAL_GATE:g} %."
        )
    return Placement(state.parameters, state.rotation, state.translation_mm), result.used


def _first(failures: dict[int, GridposeError]) -> GridposeError:
    return failures[min(failures)]


def _kept(usable: list[int], shared: SharedLens, failures: dict[int, GridposeError]) -> _Fitted:
    """Leave out views that do not fit the common camera or lie behind it."""
    kept = []
    for j, i in enumerate(usable):
        share = float(np.mean(shared.used[j]))
        if not shared.kept[j]:
            ratio = np.median(shared.at.distance[j]) / np.median([np.median(d) for d in shared.at.distance])
            failures[i] = NotConverged(
                f"The residuals of this image are {ratio:.0f} times those of the others of its focus group.",
                "Look at its overlay; an image taken with another focus or zoom needs a focus_group of its own.",
            )
        elif share < 0.5:
            failures[i] = NotConverged(
                f"Only {100.0 * share:.0f} % of the grid points of this image fit one pose.",
                "Look at its overlay: reflections, dirt or something in front of the grid are the usual causes.",
            )
        elif shared.at.placements[j].translation_mm[2] <= 0:
            failures[i] = DegenerateGeometry("The best fit puts the grid behind the camera.")
        else:
            kept.append(j)
    if not kept:
        raise _first(failures)
    all_of = shared.at
    at = Linearised(
        tuple(all_of.placements[j] for j in kept),
        all_of.normal[kept],
        all_of.gradient[kept],
        tuple(all_of.residuals[j] for j in kept),
        tuple(all_of.distance[j] for j in kept),
        all_of.cost,
    )
    return _Fitted([usable[j] for j in kept], at, tuple(shared.used[j] for j in kept), shared)


def _with_doubt(
    views: Sequence[GridPoints],
    plain: Sequence[GridPoints],
    labels: Sequence[Hashable],
    fitted: _Fitted,
    estimator: str,
    lens: Lens | None,
    failures: dict[int, GridposeError],
) -> GroupEstimate:
    """Add to placements what their residuals say of them."""
    chosen = [plain[i] for i in fitted.images]
    at = fitted.at
    own = _own_coordinates(estimator, fitted.placements)
    P = _own_priors(estimator, chosen[0], fitted.placements, lens)
    count = own.shape[2]
    freedom = np.array([max(2 * int(u.sum()) - count, 1) for u in fitted.used])
    squares = np.array([float(d[u] @ d[u]) for d, u in zip(at.distance, fitted.used, strict=True)])
    shared = fitted.shared
    scale = np.full(len(chosen), shared.scale) if shared is not None else np.sqrt(squares / freedom)
    # No fit takes its noise for less.
    scale = np.maximum(scale, [SMALLEST_NOISE_PX / float(v.standard_uncertainty_px.mean()) for v in chosen])
    noise = repeated_scales(
        chosen,
        at.residuals,
        fitted.used,
        [labels[i] for i in fitted.images],
        count,
        float(np.sqrt(np.mean(scale**2))),
    )
    N = np.swapaxes(own, 1, 2) @ at.normal @ own
    # The fit weighed data against priors by all that its residuals hold; of that only the noise scatters.
    C, scatter = pose_covariances(N / scale[:, None, None] ** 2, P)
    scatter = scatter * (noise / scale)[:, None, None] ** 2
    rotations = np.array([p.rotation for p in fitted.placements])
    centroids = np.array([p.translation_mm for p in fitted.placements])
    J = in_target_frame(rotations, centroids)
    contradiction = None
    if shared is not None:
        observations = np.array([2.0 * int(u.sum()) for u in fitted.used])
        fitted_in_common = {"pooled": 8, "pooled_free_focal": 7}.get(estimator, 0)
        contradiction = disagreement(at.normal, at.gradient, squares, observations, own, fitted_in_common)
    positions = np.array([centred(v)[1] for v in chosen]) - np.einsum("kji,kj->ki", rotations, centroids)
    common = np.zeros((len(chosen), 6, 9))
    if shared is not None:
        common[:, :, :8] = J @ _from_common(own, at.normal, shared.covariance[:8, :8])
    common[:, :3, 8] = _print_scale([views[i] for i in fitted.images])[:, None] * positions
    covariance = transformed(J, C) + common @ np.swapaxes(common, 1, 2)
    cameras = np.array([p.parameters for p in fitted.placements])
    return GroupEstimate(
        estimator=estimator,
        images=np.array(fitted.images),
        failures=tuple(sorted(failures.items())),
        camera=Camera.from_array(_mean_camera(cameras)),
        camera_covariance=_camera_covariance(estimator, fitted, at.normal, scale, P),
        cameras=cameras,
        positions_mm=positions,
        rotations=np.ascontiguousarray(np.swapaxes(rotations, 1, 2)),
        covariance=covariance,
        scatter=transformed(J, scatter),
        common=common,
        rms_px=np.array(
            [
                math.sqrt(float(np.sum(r[:, u] ** 2)) / int(u.sum()))
                for r, u in zip(at.residuals, fitted.used, strict=True)
            ]
        ),
        reduced_chi2=float(np.mean(scale**2)),
        disagreement=contradiction,
    )


def _mean_camera(cameras: Float[np.ndarray, "k 9"]) -> Float[np.ndarray, "9"]:
    """Return the mean over the images; to the last bit what all have in common."""
    common = np.all(cameras == cameras[0], axis=0)
    return np.where(common, cameras[0], cameras.mean(axis=0))


def _own_coordinates(estimator: str, placements: Sequence[Placement]) -> Float[np.ndarray, "k 14 l"]:
    """Return derivatives of camera and pose by what each view has of its own; the pose comes last."""
    pose = np.zeros((14, 6))
    pose[8:] = np.eye(6)
    if estimator == "per_image":
        own = [np.eye(14)] * len(placements)
    elif estimator == "per_image_fixed_pp":
        own = [TO_FULL_STEP] * len(placements)
    elif estimator == "pooled_free_focal":
        own = []
        for placement in placements:
            focal = np.zeros((14, 1))
            focal[:8, 0] = coordinates(placement.parameters)[:, 0]
            own.append(np.hstack([focal, pose]))
    else:
        own = [pose] * len(placements)
    return np.array(own)


def _own_priors(
    estimator: str, points: GridPoints, placements: Sequence[Placement], lens: Lens | None
) -> Float[np.ndarray, "k l l"]:
    """Return the priors' information on what each view has of its own."""
    count = len(placements)
    if estimator == "per_image":
        of_camera = camera_prior(points.image_width_px, points.image_height_px, lens, 14)
        P = []
        for placement in placements:
            _, Q = of_camera(placement.parameters)
            P.append(Q.T @ Q)
        return np.array(P)
    if estimator == "per_image_fixed_pp":
        diagonal = np.zeros(9)
        diagonal[1:3] = 1.0 / np.array(RADIAL_PRIORS) ** 2
        return np.broadcast_to(np.diag(diagonal), (count, 9, 9))
    size = 7 if estimator == "pooled_free_focal" else 6
    return np.zeros((count, size, size))


def _from_common(
    own: Float[np.ndarray, "k 14 l"],
    normal: Float[np.ndarray, "k 14 14"],
    covariance: Float[np.ndarray, "8 8"],
) -> Float[np.ndarray, "k 6 8"]:
    """Return what a standard uncertainty of the common camera in each direction does to poses: D Σ^½, D = -L⁻¹Cᵀ."""
    transposed = np.swapaxes(own, 1, 2)
    D = -np.linalg.solve(transposed @ normal @ own, transposed @ normal[:, :, :8])[:, -6:]
    unit = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    return D @ (unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def _print_scale(views: Sequence[GridPoints]) -> Float[np.ndarray, " k"]:
    """Return the relative standard uncertainty of the prints' scale: the same in every length."""
    return np.array([(v.target.pitch_standard_uncertainty_mm or 0.0) / v.target.pitch_mm for v in views])


def _camera_covariance(
    estimator: str,
    fitted: _Fitted,
    normal: Float[np.ndarray, "k 14 14"],
    scale: Float[np.ndarray, " k"],
    P: Float[np.ndarray, "k l l"],
) -> Float[np.ndarray, "9 9"]:
    """Return the covariance of the common camera, or the mean of those that images have of their own."""
    result = np.zeros((9, 9))
    own = _own_coordinates(estimator, fitted.placements)
    C = np.linalg.inv(np.swapaxes(own, 1, 2) @ (normal / scale[:, None, None] ** 2) @ own + P)
    by_own = own[:, :8]
    result[:8, :8] = transformed(by_own, C).mean(axis=0)
    return result if fitted.shared is None else result + fitted.shared.covariance
