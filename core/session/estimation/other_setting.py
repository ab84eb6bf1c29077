"""Images of a focus group that do not fit its camera, and agree with one another on a camera of their own."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import replace

import numpy as np

from core.calibration import GroupEstimate, ViewStack, estimate_group
from core.errors import Advisory, GridposeError, NotConverged, listed
from core.session.estimate import MIN_OTHER_SETTING, TURNED_ADVICE
from core.session.model import ImageObservation, SessionData

ESTIMATORS = ("pooled", "pooled_free_focal")
MIN_AGREEING = 0.7
"""Share of the images that do not fit, which have to fit a camera of their own."""
MAX_RESIDUALS = 3.0
"""Times the residuals of the group's other images, at the most, of images before a camera of their own."""


def with_setting_warning(
    name: str,
    views: ViewStack,
    images: Sequence[ImageObservation],
    repeats: Sequence[Hashable],
    estimate: GroupEstimate,
    data: SessionData,
) -> GroupEstimate:
    """Return the estimate, with the warning `camera_settings_mixed` where three or more images that do not fit its
    camera fit one of their own: they were taken with another setting of the lens or another camera, or were turned.
    """
    unlike = [i for i, failure in estimate.failures if isinstance(failure, NotConverged)]
    if estimate.estimator not in ESTIMATORS or len(unlike) < MIN_OTHER_SETTING:
        return estimate
    try:
        own = estimate_group(
            views.take(unlike), "pooled", lens=data.lens, repeats=[repeats[i] for i in unlike], weak=True
        )
    except GridposeError:
        return estimate
    agreeing = len(own.images)
    if agreeing < max(MIN_OTHER_SETTING, MIN_AGREEING * len(unlike)):
        return estimate
    if np.median(own.rms_px) > MAX_RESIDUALS * np.median(estimate.rms_px):
        return estimate
    focals = [float(np.mean(one.camera.as_array()[:2])) for one in (own, estimate)]
    which = listed([images[unlike[k]].measurement_id for k in own.images.tolist()])
    mixed = Advisory(
        "camera_settings_mixed",
        f"{agreeing} images of focus group {name!r} do not fit its camera, and agree on one of their own (f = "
        f"{focals[0]:.0f} px in place of {focals[1]:.0f} px): {which}.",
        "They were taken with another setting of the lens (focus, zoom), by another camera, or were turned before the "
        f"upload. {TURNED_ADVICE} Give the others a focus_group of their own (PATCH "
        "/v1/measurements/{measurement_id}, or at the session's images): they then count.",
    )
    return replace(estimate, warnings=(*estimate.warnings, mixed))
