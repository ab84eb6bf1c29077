"""Axes in the image's own frame, and values of square cells drawn in it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator


def frame_image(axes: Axes, width_px: int, height_px: int) -> None:
    """Set the image's own frame: u to the right, v down."""
    axes.set(xlim=(-0.5, width_px - 0.5), ylim=(height_px - 0.5, -0.5))
    axes.set_xlabel("u, px")
    axes.set_ylabel("v, px", labelpad=2)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(6))
    axes.grid(False)


def draw_cells(
    figure: Figure,
    axes: Axes,
    bar: Axes,
    values: Float[np.ndarray, "r c"],
    cell_px: float,
    top: float,
    unit: str,
    *,
    extend: str = "neither",
) -> None:
    """Colour cells by their values from zero to `top`, with a bar in `unit`; a value that is not finite is blank."""
    rows, columns = values.shape
    mesh = axes.pcolormesh(
        np.arange(columns + 1) * cell_px - 0.5,
        np.arange(rows + 1) * cell_px - 0.5,
        np.ma.masked_invalid(values),
        vmin=0.0,
        vmax=top,
        cmap="viridis",
        rasterized=False,
    )
    colourbar = figure.colorbar(mesh, cax=bar, extend=extend)
    colourbar.set_label(unit)
    colourbar.outline.set_linewidth(0.6)
    bar.grid(False)
