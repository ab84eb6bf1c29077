"""What a session will be able to say of a robot's repeatability, before anything is measured.

The views that are planned are simulated, corners with their noise instead of images, and estimated as a session is. The
covariances found so are those of the planned measurements; robots of an assumed repeatability are then drawn many times
and judged. Corner noise is taken as white: where a session's is not, its own floor is higher.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.calibration import estimate_group
from core.errors import InvalidArgument
from core.geometry import Camera, project, transform_points
from core.metrology import (
    Decision,
    PoseCycles,
    PoseRepeatability,
    Reading,
    assess_repeatability,
    decide,
    long_run_rp,
    repeatability_reading,
)
from core.simulation.looking import in_view
from core.targets import GridPoints, TargetSpec

MIN_CYCLES, MAX_CYCLES = 2, 200
MAX_IMAGES_PER_STOP = 20


@dataclass(frozen=True, slots=True)
class PlannedSession:
    """What is planned: target, camera (px), image size (px), and views as T_camera_target (mm), one a pose.

    `cycles` is how often each pose is visited. `additional_views` are taken once: tilted ones, which determine
    the lens. `corner_sigma_px` is the standard deviation of a grid point's coordinates. A stop of `images_per_stop`
    images, a burst, counts once, as their mean.
    """

    target: TargetSpec
    camera: Camera
    size_px: tuple[int, int]
    views: Float[np.ndarray, "p 4 4"]
    additional_views: Float[np.ndarray, "m 4 4"]
    cycles: int
    corner_sigma_px: float
    images_per_stop: int = 1


@dataclass(frozen=True, slots=True)
class PoseForecast:
    """What is expected of one pose, mm and without unit.

    `floor_mm` is the noise floor of RP_l; `reading_mm` the median RP_l that will be read, `interval_mm` the median of
    its interval, `verdicts` the share of sessions with each verdict.
    """

    in_view: bool
    floor_mm: float
    reading_mm: float
    interval_mm: tuple[float, float]
    verdicts: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Forecast:
    """The poses in the order of the views, and the share of sessions with each decision on a limit that is stated: no
    session passes with a view that does not show the target whole.
    """

    poses: tuple[PoseForecast, ...]
    decisions: Mapping[str, float] | None


def forecast_repeatability(
    planned: PlannedSession,
    rp_mm: float,
    *,
    limit_mm: float | None = None,
    draws: int = 200,
) -> Forecast:
    """Predict floor, interval and verdicts of a planned session for a robot whose RP_l is `rp_mm` at every pose.

    The robot scatters equally in all directions. `limit_mm` is a data sheet's RP_l to be decided on.

    Raises InvalidArgument for figures that cannot be, and where no view shows the target whole; FocalNotObservable
    where the focal length is not observable in the views: tilt them.
    """
    if not MIN_CYCLES <= planned.cycles <= MAX_CYCLES:
        raise InvalidArgument(f"Plan {MIN_CYCLES} to {MAX_CYCLES} cycles.")
    if not 1 <= planned.images_per_stop <= MAX_IMAGES_PER_STOP:
        raise InvalidArgument(f"Plan 1 to {MAX_IMAGES_PER_STOP} images at each stop.")
    if not (rp_mm > 0.0 and planned.corner_sigma_px > 0.0 and (limit_mm is None or limit_mm > 0.0)):
        raise InvalidArgument("Repeatability, limit and corner noise must be larger than 0.")
    shown = in_view(planned.views, planned.target, planned.camera, planned.size_px)
    if not shown.any():
        raise InvalidArgument(
            "No planned view shows the whole target.",
            "Plan a larger distance, a smaller target or cube, or a shorter focal length.",
        )
    rng = np.random.default_rng(0)
    measured = _measured(planned, shown, rng)
    still = assess_repeatability(measured)
    sigma_mm = rp_mm / float(long_run_rp(np.ones((1, 3)))[0])
    sessions = [assess_repeatability(_moved(measured, sigma_mm, rng)) for _ in range(draws)]
    found = iter([_forecast(figures, [of[k] for of in sessions]) for k, figures in enumerate(still)])
    unseen = PoseForecast(False, np.nan, np.nan, (np.nan, np.nan), {})
    decisions = None
    if limit_mm is not None:
        # What is planned and not measured may be the worst.
        lacking = [Reading(0, None, None, None)] * int((~shown).sum())
        readings = ([*(repeatability_reading(one) for one in session), *lacking] for session in sessions)
        made = Counter(decide(limit_mm, of_session).decision for of_session in readings)
        decisions = {decision.value: made[decision] / draws for decision in Decision}
    return Forecast(tuple(next(found) if one else unseen for one in shown.tolist()), decisions)


def _measured(
    planned: PlannedSession, shown: Bool[np.ndarray, " p"], rng: np.random.Generator
) -> list[PoseCycles]:
    """Return what a session of a motionless robot would measure at the poses that are shown."""
    grid = planned.target.points_target()
    also = in_view(planned.additional_views, planned.target, planned.camera, planned.size_px)
    visited = np.repeat(planned.views[shown], planned.cycles, axis=0)
    views = []
    for T_camera_target in (*visited, *planned.additional_views[also]):
        exact = project(transform_points(T_camera_target, grid), planned.camera)
        noisy = exact + rng.normal(0.0, planned.corner_sigma_px, exact.shape)
        views.append(GridPoints.whole(planned.target, planned.size_px, noisy, planned.corner_sigma_px))
    estimate = estimate_group(views, "pooled")
    pose = estimate.images // planned.cycles
    return [
        PoseCycles(
            estimate.positions_mm[of], estimate.rotations[of], estimate.scatter[of] / planned.images_per_stop
        )
        for of in (pose == k for k in range(int(shown.sum())))
    ]


def _moved(measured: Sequence[PoseCycles], sigma_mm: float, rng: np.random.Generator) -> list[PoseCycles]:
    """Draw what a robot that scatters would measure; its orientation is left as it is."""
    moved = []
    for cycles in measured:
        assert cycles.covariances is not None
        noise = np.linalg.cholesky(cycles.covariances[:, :3, :3]) @ rng.standard_normal((len(cycles), 3, 1))
        positions = rng.normal(0.0, sigma_mm, (len(cycles), 3)) + noise[:, :, 0]
        moved.append(PoseCycles(positions, cycles.rotations, cycles.covariances))
    return moved


def _forecast(still: PoseRepeatability, sessions: Sequence[PoseRepeatability]) -> PoseForecast:
    readings = np.array([one.repeatability.position_mm for one in sessions])
    low, high = np.median([one.interval.position_mm for one in sessions], axis=0).tolist()
    verdicts = Counter(one.verdict for one in sessions)
    return PoseForecast(
        True,
        float(still.noise_floor.position_mm or 0.0),
        float(np.median(readings)),
        (low, high),
        {verdict.value: count / len(sessions) for verdict, count in sorted(verdicts.items())},
    )
