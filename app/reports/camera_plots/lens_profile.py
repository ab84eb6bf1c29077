"""What lens models leave over along the radius: a pattern there is a lens beyond its model, not noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from app.reports.camera_plots.radial_bins import RadialResiduals, radial_bins
from app.reports.svg import BLUE, FAINT, GREEN, INK, NORMAL_95, ORANGE, RED, axes_at, draw_svg, short, text_at

_LEFT, _PANEL_WIDTH, _PANEL_HEIGHT = 0.8, 6.6, 2.6
_HEADER, _CAPTION, _BELOW, _FOOTER = 0.62, 0.72, 0.62, 0.72
_STYLES = {
    "brown": ("Brown", ORANGE, "o"),
    "kannala_brandt": ("Kannala-Brandt", BLUE, "s"),
    "rational": ("rational", GREEN, "^"),
}


_FOLD: dict[str, Any] = {"color": RED, "lw": 1.4, "ls": (0, (6, 2, 1, 2))}


@dataclass(frozen=True, slots=True)
class LensProfile:
    """One focus group: the models that were fitted, the one that was chosen, and how far the grid points reach."""

    focus_group: str
    images: int
    chosen: str
    evidence: str
    observed_px: float
    models: Sequence[RadialResiduals]


def lens_profile_svg(profiles: Sequence[LensProfile], title: str, about: str = "") -> bytes:
    """Return a panel for each focus group."""
    described = [" ".join(_captions(profile)) for profile in profiles]
    return draw_svg(lambda: lens_profile_figure(profiles, title), title, "\n".join(described), about)


def lens_profile_figure(profiles: Sequence[LensProfile], title: str) -> Figure:
    """Draw it; within `drawing_style`."""
    row = _CAPTION + _PANEL_HEIGHT + _BELOW
    figure = Figure((_LEFT + _PANEL_WIDTH + 0.3, _HEADER + row * len(profiles) + _FOOTER))
    text_at(figure, 0.15, 0.32, title, fontsize=12, weight="bold")
    for place, profile in enumerate(profiles):
        top = _HEADER + place * row
        first, second = _captions(profile)
        text_at(figure, 0.15, top + 0.12, first)
        text_at(figure, 0.15, top + 0.34, second, color="#555555", fontsize=8)
        _draw(axes_at(figure, _LEFT, top + _CAPTION, _PANEL_WIDTH, _PANEL_HEIGHT), profile)
    handles = _legend(profiles)
    figure.legend(handles=handles, loc="lower center", ncols=min(len(handles), 3), columnspacing=1.6)
    return figure


def _captions(profile: LensProfile) -> tuple[str, str]:
    each = "   ·   ".join(
        f"{_STYLES[model.model][0]}: {model.rms_px:.3g} px rms"
        + (f", turns back at {model.fold_px:.0f} px" if model.fold_px is not None else "")
        for model in profile.models
    )
    chosen = _STYLES[profile.chosen][0]
    return (
        f"{short(profile.focus_group)}: {chosen} lens model, {profile.images} images; points reach "
        f"{profile.observed_px:.0f} px from the principal point.",
        f"{profile.evidence} {each}",
    )


def _draw(axes: Axes, profile: LensProfile) -> None:
    axes.axhline(0.0, color=INK, lw=0.7, zorder=1)
    axes.axvline(profile.observed_px, color=FAINT, lw=1.2, ls=(0, (4, 3)), zorder=1)
    reach = 1.15 * profile.observed_px
    for model in profile.models:
        _, colour, marker = _STYLES[model.model]
        bins = radial_bins(model, profile.observed_px)
        axes.errorbar(
            bins.middle_px,
            bins.mean_px,
            NORMAL_95 * bins.error_px,
            marker=marker,
            ms=4,
            color=colour,
            elinewidth=0.8,
            mfc=colour if model.model == profile.chosen else "white",
            lw=1.2,
        )
        if model.fold_px is not None and model.fold_px <= reach:
            axes.axvline(model.fold_px, **_FOLD, zorder=1)
    axes.set_xlim(0.0, reach)
    axes.xaxis.set_major_locator(MaxNLocator(8))
    axes.yaxis.set_major_locator(MaxNLocator(5))
    axes.set_xlabel("distance from the principal point, px")
    axes.set_ylabel("mean residual outwards, px", labelpad=2)


def _legend(profiles: Sequence[LensProfile]) -> list[Any]:
    seen = {model.model for profile in profiles for model in profile.models}
    handles: list[Any] = [
        Line2D([], [], color=colour, marker=marker, ms=4, label=f"{name}, mean ± 95 %")
        for model, (name, colour, marker) in _STYLES.items()
        if model in seen
    ]
    handles.append(Line2D([], [], color=FAINT, lw=1.2, ls=(0, (4, 3)), label="observed radius"))
    reaches = [
        model.fold_px is not None and model.fold_px <= 1.15 * profile.observed_px
        for profile in profiles
        for model in profile.models
    ]
    if any(reaches):
        handles.append(Line2D([], [], **_FOLD, label="fold radius"))
    return handles
