"""The plot of a session's lens choice: each model's residuals along the radius, for `camera_plots.lens_profile`."""

from __future__ import annotations

from collections.abc import Mapping

from app.analyses.documents.camera.residual_field import radial_residuals
from app.analyses.outcome import AnalysisError
from app.reports.camera_plots.lens_profile import LensProfile, lens_profile_svg
from app.reports.forms import words
from core import GridposeError
from core.geometry import LensModel, lens_model_of
from core.session import FocusGroup, SessionData, estimate_session, observed_radius

COMPARED: tuple[LensModel, ...] = ("brown", "kannala_brandt")
MAX_GROUPS = 10


def lens_profile_plot(data: SessionData, settings: Mapping[str, str], about: str) -> bytes:
    """Return what `GET .../intrinsics/lens.svg` answers: the chosen model, and those it was compared with."""
    estimate = estimate_session(data, settings["estimator"], weak=True)
    if len(estimate.groups) > MAX_GROUPS:
        raise AnalysisError(
            "too_many_for_plot",
            f"The session has {len(estimate.groups)} focus groups; one plot shows {MAX_GROUPS}.",
            "The session's intrinsics have each group's evidence (GET .../intrinsics: `lens_evidence`).",
        )
    others = {model: _with_model(data, settings["estimator"], model) for model in COMPARED}
    profiles = []
    for group in estimate.groups:
        chosen = lens_model_of(group.estimate.camera)
        fitted = {chosen: group}
        fitted |= {
            model: groups[group.name]
            for model, groups in others.items()
            if model != chosen and group.name in groups
        }
        profiles.append(
            LensProfile(
                group.name,
                len(group.views),
                chosen,
                _evidence(group),
                observed_radius(group),
                [radial_residuals(fitted[model]) for model in sorted(fitted)],
            )
        )
    return lens_profile_svg(profiles, f"Lens models along the radius ({words(settings['estimator'])})", about)


def _with_model(data: SessionData, estimator: str, model: LensModel) -> dict[str, FocusGroup]:
    """Return the groups estimated with a model; none where it cannot be fitted, and then it is not drawn."""
    try:
        return {group.name: group for group in estimate_session(data, estimator, model, weak=True).groups}
    except GridposeError:
        return {}


def _evidence(group: FocusGroup) -> str:
    if group.evidence is None:
        return "Too few images to compare models."
    found = group.evidence
    held = "" if found.held_out is None else f", held-out residuals {found.held_out:.3f} of Brown's"
    return f"w {found.statistic:.0f}, share {100.0 * found.share:.1f} %{held}."
