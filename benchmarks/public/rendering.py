"""Images of the suite, rendered once and kept as PNG in a folder outside the repository."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np
from platformdirs import user_cache_path
from scipy.special import ndtr

import core.simulation
from benchmarks.public.suite import Item
from core.simulation import render_levels

DEFAULT_FOLDER = user_cache_path("gridpose", appauthor=False) / "public-benchmark"


def prepare_images(items: Iterable[Item], folder: Path, jobs: int) -> int:
    """Render what the folder lacks with `jobs` processes; return how many images that were."""
    folder.mkdir(parents=True, exist_ok=True)
    missing = [item for item in items if not path_of(item, folder).exists()]
    if jobs == 1 or len(missing) < 2:
        for item in missing:
            _write(item, folder)
    else:
        with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
            list(pool.map(_write, missing, [folder] * len(missing), chunksize=4))
    return len(missing)


def image_of(item: Item, folder: Path) -> np.ndarray:
    """Return an image that `prepare_images` has rendered, (h, w) uint8."""
    path = path_of(item, folder)
    image = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise ValueError(f"{path} is damaged: delete it, and it is rendered anew.")
    return np.asarray(image)


def path_of(item: Item, folder: Path) -> Path:
    """Return where an image is kept: the name has what is in it and by which renderer."""
    scene = item.scene
    parts = [repr(replace(scene, T_camera_target=np.eye(4))), scene.T_camera_target.tobytes().hex()]
    if item.disc is not None:
        disc = item.disc
        parts += [disc.centre_px.tobytes().hex(), repr((disc.radius_px, disc.grey_level))]
    digest = hashlib.sha256("|".join([_renderer(), *parts]).encode()).hexdigest()[:20]
    return folder / f"{digest}.png"


def render_item(item: Item) -> np.ndarray:
    """Return the image of one item, (h, w) uint8: the scene, what hides part of it, and noise on both."""
    levels = render_levels(item.scene)
    if item.disc is not None:
        v, u = np.mgrid[0 : levels.shape[0], 0 : levels.shape[1]]
        away = np.hypot(u - item.disc.centre_px[0], v - item.disc.centre_px[1]) - item.disc.radius_px
        hidden = ndtr(-away / np.hypot(item.scene.blur_px, np.sqrt(1.0 / 12.0)))
        levels = (1.0 - hidden) * levels + hidden * item.disc.grey_level
    rng = np.random.default_rng([item.scene.seed, item.scene.target.size, 3])
    levels = levels + rng.normal(0.0, item.scene.noise_levels, levels.shape)
    return np.asarray(np.clip(np.rint(levels), 0, 255).astype(np.uint8))


def _write(item: Item, folder: Path) -> None:
    cv2.setNumThreads(1)
    data = cv2.imencode(".png", render_item(item))[1].tobytes()
    handle, name = tempfile.mkstemp(dir=folder, suffix=".part")
    with os.fdopen(handle, "wb") as file:
        file.write(data)
    Path(name).replace(path_of(item, folder))  # whole or not at all: another run may be reading


@cache
def _renderer() -> str:
    """Return a digest of the renderer's sources, so that an image of another version is not taken for this one's."""
    sources = sorted(Path(core.simulation.__file__).parent.glob("*.py"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in (*sources, Path(__file__)))).hexdigest()
