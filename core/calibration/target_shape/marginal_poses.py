"""Poses of one camera before prints that may depart from their nominal grid, the departures marginalised.

A print's scale, aspect, shear, bow, twist, quadratic distortion and each point's own departure, and the sensor's skew,
are parameters of the bundle with priors of known width (`departures`). With z = (camera, skew, departures) and a
pose's six l,

    S = N_zz + P - Σ N_zl N_ll⁻¹ N_lz,      l = N_ll⁻¹ (b_l - N_lz z),      cov(l) ∋ N_ll⁻¹ N_lz S⁻¹ N_zl N_ll⁻¹,

so that poses move to where the departures found put them, and share what these leave open. All images of a pose show
the same departures: their residuals enter as one mean, and all of them move equally, so that scatter stays as it is.

The noise is that of residuals about their mean over the images of a pose, or of the fit without repeats. What
residuals of means hold beyond it inflates the covariance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.calibration.multi_view import CommonFit, in_target_frame
from core.calibration.target_shape.covariance_factors import compressed_by_source, inverse, triangular_root
from core.calibration.target_shape.departures import LENS, PRINT_SCALE, ShapePrior
from core.calibration.target_shape.print_bundle import BundleState, BundleSystem, PrintBundle
from core.geometry import so3_log


@dataclass(frozen=True)
class MarginalPoses:
    """How the m poses of k images move when their prints may depart from the nominal grid, in the target frame.

    `place` (k,) says which pose each image shows. `moved_mm` and `turned` (m, 3) lead from the fit's poses to these:
    p + moved, exp(turned) R. `common` (m, 6, e) is what one standard uncertainty of each error that all poses share
    does to them; `sources` (e,) says of which: `lens` (and sensor), `print_scale` or `print_shape`. `of_camera` is that
    of the camera alone, were the prints perfect. `camera_moved` (f,) leads from the fit's camera to this one's, and
    `camera_of_print` (f, f) is the covariance of the latter that is the departures'.
    """

    place: Int[np.ndarray, " k"]
    moved_mm: Float[np.ndarray, "m 3"]
    turned: Float[np.ndarray, "m 3"]
    common: Float[np.ndarray, "m 6 e"]
    sources: tuple[str, ...]
    of_camera: Float[np.ndarray, "m 6 c"]
    camera_moved: Float[np.ndarray, " f"]
    camera_of_print: Float[np.ndarray, "f f"]


def marginalise_shape(
    fit: CommonFit, priors: Sequence[ShapePrior], *, noise_known: bool = False
) -> MarginalPoses:
    """Estimate camera, poses and the departures of the prints together, from the fit of a camera before perfect ones.

    `priors` is one for each of the targets of `fit.views`. With `noise_known` the noise is the fit's, as that of points
    that are simulated without any.
    """
    bundle = PrintBundle.of(fit, priors)
    state, system = bundle.solved(bundle.start())
    growth = 1.0 if noise_known else bundle.growth(system)
    # The data's noise grows; the priors stay as stated.
    bundle = bundle.with_noise_of(math.sqrt(growth))
    state, system = bundle.solved(state)
    return _result(bundle, state, system)


def _result(bundle: PrintBundle, state: BundleState, system: BundleSystem) -> MarginalPoses:
    C = system.covariance()
    sensor = slice(0, bundle.free + 1)  # the camera and the sensor's skew
    of_print_known = inverse(system.information[sensor, sensor])
    start = bundle.start()
    J = in_target_frame(state.rotations, state.translations_mm)
    # Columns of a triangular root: of the camera, were the print known, and of each departure, were those behind
    # it known, with what the camera makes of it.
    common = -J @ system.follows @ triangular_root(system.information)
    of_camera = common[:, :, : bundle.free]
    scales = np.zeros((len(bundle.views), 6, len(bundle.departures)))
    centroids = np.array([view.centroid for view in bundle.views])
    places = centroids - np.einsum("mji,mj->mi", state.rotations, state.translations_mm)
    for k, (departures, begin) in enumerate(zip(bundle.departures, bundle.first, strict=True)):
        if "aspect" in departures.names and not departures.certified:
            here = begin + departures.names.index("aspect")
            uncertainty = math.sqrt(max(float(C[here, here]), 0.0))
            left = departures.scale_left(
                departures.aspect * float(state.shared[here]), departures.aspect * uncertainty
            )
            of_target = np.array([view.target == k for view in bundle.views])
            scales[of_target, :3, k] = left * places[of_target]
    sources = [LENS] * (bundle.free + 1)  # the sensor's skew, too
    sources += [source for departures in bundle.departures for source in departures.sources()]
    sources += [PRINT_SCALE] * len(bundle.departures)
    whitener = np.swapaxes(system.pose_roots, 1, 2) @ np.linalg.inv(J)
    common, kept = compressed_by_source(np.concatenate([common, scales], axis=2), sources, whitener)
    before = centroids - np.einsum("mji,mj->mi", start.rotations, start.translations_mm)
    turned = np.array(
        [so3_log(new.T @ old) for new, old in zip(state.rotations, start.rotations, strict=True)]
    )
    place = np.empty(len(bundle.fit.views), dtype=np.intp)
    for g, view in enumerate(bundle.views):
        place[view.images] = g
    return MarginalPoses(
        place,
        places - before,
        turned,
        common,
        kept,
        of_camera,
        state.parameters[: bundle.free] - start.parameters[: bundle.free],
        C[: bundle.free, : bundle.free] - of_print_known[: bundle.free, : bundle.free],
    )
