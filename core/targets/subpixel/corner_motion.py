"""The corners of a grid between two steps: their edges by the grid's map, and the corners moved."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Int

from core.jit import jit
from core.targets.subpixel.corner_model import (
    CONTRAST,
    N1_U,
    N1_V,
    N2_U,
    N2_V,
    Q_U,
    Q_V,
    SIGMA_1,
    SIGMA_2,
    SPACING_1,
    STEP_U,
    STEP_V,
    UNEVEN,
    WIDER_1,
    half_band,
)

_MAX_WIDER = 0.7  # the logarithm of the blur, in one step


@jit("f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8, f8, i8, i8")
def place_edges(
    states: Float[np.ndarray, "n state"],
    along_x: Float[np.ndarray, "n 2"],
    along_y: Float[np.ndarray, "n 2"],
    bend_x: Float[np.ndarray, "n 2"],
    bend_y: Float[np.ndarray, "n 2"],
    reach_px: float,
    reach_share: float,
    width: int,
    height: int,
) -> None:
    """Set directions, bends, spacings and reaches of the two edges of each corner.

    `along_` and `bend_` are the first and second derivatives of the grid's map. An edge reaches `reach_px`,
    `reach_share` of the spacing, and as far as its band is in the image to both sides.
    """
    for k in range(states.shape[0]):
        s = states[k]
        room_u, room_v = min(s[Q_U], width - 1.0 - s[Q_U]), min(s[Q_V], height - 1.0 - s[Q_V])
        for edge in range(2):
            along, across = (along_y[k], along_x[k]) if edge == 0 else (along_x[k], along_y[k])
            bend = bend_y[k] if edge == 0 else bend_x[k]
            at = N1_U if edge == 0 else N2_U
            length = max(math.hypot(along[0], along[1]), 1e-9)
            n_u, n_v = along[1] / length, -along[0] / length
            spacing = n_u * across[0] + n_v * across[1]
            if spacing < 0.0:
                n_u, n_v, spacing = -n_u, -n_v, -spacing
            half_width = half_band(s[SIGMA_1 + edge])
            reach = min(reach_px, reach_share * length)
            reach = min(reach, (room_u - half_width * abs(n_u)) / max(abs(n_v), 1e-9))
            reach = min(reach, (room_v - half_width * abs(n_v)) / max(abs(n_u), 1e-9))
            s[at], s[at + 1], s[at + 2] = n_u, n_v, (n_u * bend[0] + n_v * bend[1]) / length**2
            s[at + 3], s[SPACING_1 + edge] = max(reach, 0.0), spacing


@jit("f8[:, ::1], f8[:, ::1], i8[::1], b1, f8, f8, f8, f8")
def move_corners(
    states: Float[np.ndarray, "n state"],
    steps: Float[np.ndarray, "n step"],
    chosen: Int[np.ndarray, " k"],
    knows_blur: bool,
    most_sigmas: float,
    variation: float,
    least_sigma: float,
    largest_sigma: float,
) -> None:
    """Move the chosen corners by their steps, at most so many σ, and their blur; steps that are NaN move nothing.

    Blurs stay within a factor `variation` of the median of all corners whose last step succeeded, and between the two
    limits.
    """
    for k in chosen:
        s, step = states[k], steps[k]
        if not _succeeded(step):
            continue
        length = math.hypot(step[STEP_U], step[STEP_V])
        scale = min(1.0, most_sigmas * max(s[SIGMA_1], s[SIGMA_2]) / max(length, 1e-12))
        s[Q_U] += scale * step[STEP_U]
        s[Q_V] += scale * step[STEP_V]
        if knows_blur:
            for edge in range(2):
                wider = min(max(step[WIDER_1 + edge], -_MAX_WIDER), _MAX_WIDER)
                s[SIGMA_1 + edge] *= math.exp(wider)
    if not knows_blur:
        return
    # of all corners: the few that a last step is for may be those that a highlight leads astray
    sigmas = np.empty(2 * states.shape[0])
    count = 0
    for k in range(states.shape[0]):
        if _succeeded(steps[k]):
            sigmas[count], sigmas[count + 1] = states[k, SIGMA_1], states[k, SIGMA_2]
            count += 2
    typical = np.median(sigmas[:count]) if count > 0 else 1.0
    for k in range(states.shape[0]):
        for at in (SIGMA_1, SIGMA_2):
            sigma = min(max(states[k, at], typical / variation), typical * variation)
            states[k, at] = min(max(sigma, least_sigma), largest_sigma)


@jit("f8[::1]")
def _succeeded(step: Float[np.ndarray, " step"]) -> bool:
    """Return whether a step has a length, and a contrast of the right sign."""
    return math.isfinite(math.hypot(step[STEP_U], step[STEP_V])) and step[CONTRAST] > 0.0


@jit("f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1]")
def follow_edges(
    states: Float[np.ndarray, "n state"],
    steps: Float[np.ndarray, "n step"],
    along_x: Float[np.ndarray, "n 2"],
    along_y: Float[np.ndarray, "n 2"],
    bend_x: Float[np.ndarray, "n 2"],
    bend_y: Float[np.ndarray, "n 2"],
) -> None:
    """Move the corners by what their edges' bends differ from those that the last step had; see `place_edges`.

    An edge bent by κ is displaced by ½ κ s², over its reach r to both sides on average κ r² / 6. Its arms, on
    average at ± r / 2, are as uneven as the turn from the directions used, too, and no more.
    """
    shifts = np.empty(2)
    for k in range(states.shape[0]):
        s = states[k]
        for edge in range(2):
            along, bend = (along_y[k], bend_y[k]) if edge == 0 else (along_x[k], bend_x[k])
            at = N1_U if edge == 0 else N2_U
            length = max(math.hypot(along[0], along[1]), 1e-9)
            reach = s[at + 3]
            bend_now = (s[at] * bend[0] + s[at + 1] * bend[1]) / length**2
            turn = (s[at] * along[0] + s[at + 1] * along[1]) / length * reach
            shifts[edge] = (s[at + 2] - bend_now) * reach**2 / 6.0
            s[at + 2] = bend_now
            steps[k, UNEVEN] += turn if edge == 1 else -turn
        skew = s[N1_U] * s[N2_V] - s[N1_V] * s[N2_U]
        s[Q_U] += (s[N2_V] * shifts[0] - s[N1_V] * shifts[1]) / skew
        s[Q_V] += (s[N1_U] * shifts[1] - s[N2_U] * shifts[0]) / skew
