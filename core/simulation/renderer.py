"""Images of scenes, exact in geometry: edges stand within 1e-4 px of where the camera model puts them.

The ideal image (1 on white, 0 on black ink) is convolved with the lens's Gaussian of standard deviation σ and
with the pixel's square. In two steps, so that nothing is sampled too coarsely:

1. On a grid m times finer than the pixels (spacing h = 1/m) the ideal image convolved with a small Gaussian,
   σ₀ = ¾ h, is evaluated in closed form. Around a fine sample p the lines of the pattern are straight: a
   line's signed distance is a = L(p) / |∇L(p)|, with L linear in undistorted coordinates, so that perspective
   is exact and only the lens's distortion is linearised, over a few σ₀. Near one line the value is Φ(a/σ₀);
   near the crossing of two it is made of bivariate normal probabilities with the correlation ∇Lx·∇Ly / (|∇Lx|
   |∇Ly|).
2. The rest of the blur and the mean over the pixel's m x m samples are one separable filter. The rest is
   √(σ² - σ₀² + h²/12): m points a pixel have h²/12 less variance than the pixel's square. The Gaussian of step 1
   leaves next to nothing above the fine grid's Nyquist frequency that could alias.

The total point spread function is symmetric, so it moves no edge. Beyond step 1's reach a sample is its
cell's ink.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, UInt8, UInt16

from core.errors import InvalidArgument
from core.geometry import project, transform_points
from core.jit import jit
from core.simulation.background import background, illumination
from core.simulation.pattern_coverage import Coverage
from core.simulation.scenes import Scene
from core.targets import DotPattern, RectilinearPattern, pattern_of

_TILE_PX = 80
_REACH = 5.0  # standard deviations; Φ(-5) = 3e-7


def render(scene: Scene) -> UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"]:
    """Return the image of a scene, uint8 or (bit_depth 16) uint16.

    Raises
    ------
    InvalidArgument
        The sheet reaches behind the camera.
    InvalidTarget
        The target's kind cannot be rendered.
    """
    levels = render_levels(scene)
    if scene.noise_levels > 0.0:
        rng = np.random.default_rng([scene.seed, 1])
        levels += np.float32(scene.noise_levels) * rng.standard_normal(levels.shape, dtype=np.float32)
    if scene.bit_depth == 16:
        return np.asarray(np.clip(np.rint(levels * 257.0), 0, 65535).astype(np.uint16))
    return np.asarray(np.clip(np.rint(levels), 0, 255).astype(np.uint8))


def render_levels(scene: Scene) -> Float[np.ndarray, "h w"]:
    """Return the noise-free image in 8-bit grey levels, not rounded; float32."""
    white, sheet = _render_sheet(scene)
    light = scene.light
    levels = light.black_level * sheet + (light.white_level - light.black_level) * white
    levels += (1.0 - sheet) * background(scene)
    levels *= illumination(scene)
    return levels


def _render_sheet(scene: Scene) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """Return how much of each pixel's light comes from white ink, and from the sheet at all."""
    pattern = pattern_of(scene.target, scene.quiet_zone, scene.origin_dot, marks=scene.marks)
    whole = np.zeros((2, scene.height_px, scene.width_px), dtype=np.float32)
    fine = max(2, math.ceil(0.9 / scene.blur_px))
    fine_blur_px = 0.75 / fine
    rest_px = math.sqrt(scene.blur_px**2 - fine_blur_px**2 + 1.0 / (12.0 * fine**2))
    halo = math.ceil(_REACH * rest_px) + 1
    coverage = Coverage(pattern, scene.camera, scene.T_camera_target, fine_blur_px)
    left, top, right, bottom = _bounds(scene, pattern, halo)
    if left >= right or top >= bottom:
        return whole[0], whole[1]
    kernel = _pixel_kernel(fine, rest_px, halo)
    us, vs = (
        [(k, min(k + _TILE_PX, end)) for k in range(begin, end, _TILE_PX)]
        for begin, end in ((left, right), (top, bottom))
    )
    lens = coverage.lens(
        *([_fine_places(a - halo, b - a + 2 * halo, fine) for a, b in tiles] for tiles in (us, vs))
    )
    for row, (v, v_end) in enumerate(vs):
        for column, (u, u_end) in enumerate(us):
            tile = lens.tile(row, column)
            samples = np.empty((2, len(tile.B_v), len(tile.B_u)), dtype=np.float32)
            coverage.sample(tile, samples)
            for ink in range(2):
                pixel_means(samples[ink], kernel, fine, whole[ink, v:v_end, u:u_end])
    return whole[0], whole[1]


@jit("f4[:, ::1], f4[::1], i8, f4[:, :]", reassociates=True)
def pixel_means(
    samples: Float[np.ndarray, "hf wf"],
    kernel: Float[np.ndarray, " n"],
    fine: int,
    means: Float[np.ndarray, "h w"],
) -> None:
    """Write the weighted mean of the samples from each pixel's place (v, u) times `fine` on; weights sum to 1."""
    level, even = samples[0, 0], True
    for v in range(samples.shape[0]):
        for u in range(samples.shape[1]):
            even &= samples[v, u] == level
        if not even:
            break
    if even:
        means[:] = level
        return
    height, width = means.shape
    along = np.empty((samples.shape[0], width), dtype=np.float32)
    for v in range(samples.shape[0]):
        for u in range(width):
            total = np.float32(0.0)
            for k in range(len(kernel)):
                total += kernel[k] * samples[v, u * fine + k]
            along[v, u] = total
    for v in range(height):
        for u in range(width):
            means[v, u] = np.float32(0.0)
        for k in range(len(kernel)):
            for u in range(width):
                means[v, u] += kernel[k] * along[v * fine + k, u]


def _bounds(scene: Scene, pattern: RectilinearPattern | DotPattern, halo: int) -> tuple[int, int, int, int]:
    """Return left, top, right, bottom (px, the latter two exclusive) of what the sheet can touch."""
    x, y = pattern.x_edges[[0, -1]], pattern.y_edges[[0, -1]]
    along = np.linspace(0.0, 1.0, 65)
    x_side, y_side = x[0] + along * (x[1] - x[0]), y[0] + along * (y[1] - y[0])
    outline = np.concatenate(
        [np.stack([x_side, np.full(65, edge), np.zeros(65)], axis=1) for edge in y]
        + [np.stack([np.full(65, edge), y_side, np.zeros(65)], axis=1) for edge in x]
    )
    points_camera = transform_points(scene.T_camera_target, outline)
    if np.any(points_camera[:, 2] <= 0.0):
        raise InvalidArgument("The sheet reaches behind the camera.")
    pixels = project(points_camera, scene.camera)
    least, most = np.floor(pixels.min(axis=0)) - halo, np.ceil(pixels.max(axis=0)) + halo + 1
    size = np.array([scene.width_px, scene.height_px])
    (left, top), (right, bottom) = (np.clip(bound, 0, size).astype(int) for bound in (least, most))
    return int(left), int(top), int(right), int(bottom)


def _fine_places(first_px: int, pixels: int, fine: int) -> Float[np.ndarray, " n"]:
    """Return the centres of `fine` samples in each pixel, in pixel coordinates."""
    return first_px - 0.5 + (np.arange(pixels * fine) + 0.5) / fine


def _pixel_kernel(fine: int, rest_px: float, halo: int) -> Float[np.ndarray, " n"]:
    """Return the weights of the fine samples around a pixel's first one: Gaussian, then the pixel's mean."""
    reach = halo * fine
    distance = (np.arange(-reach, reach + 1)[:, None] - np.arange(fine)[None, :]) / fine
    kernel: Float[np.ndarray, " n"] = np.exp(-0.5 * (distance / rest_px) ** 2).sum(axis=1)
    return np.asarray(kernel / kernel.sum(), dtype=np.float32)
