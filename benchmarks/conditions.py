"""Conditions that the benchmarks share: one pinned core, a stopwatch, the standard scenes."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import cv2
import numpy as np

from core.simulation import Scene, background, illumination
from tests.support.simulation.scenes import standard_scene, standard_target

BOARDS = ((9, 6), (14, 10), (25, 18))


@contextmanager
def one_core() -> Iterator[None]:
    """Pin this process to one core, and OpenCV to one thread, for the time of a comparison."""
    threads = cv2.getNumThreads()
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    cv2.setNumThreads(1)
    if cores:
        os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        cv2.setNumThreads(threads)
        if cores:
            os.sched_setaffinity(0, cores)


def seconds(call: Callable[[], object]) -> float:
    """Return how long a call takes."""
    started = time.perf_counter()
    call()
    return time.perf_counter() - started


def standard_scenes(
    seeds: Sequence[int], boards: Sequence[tuple[int, int]], per_seed: int
) -> Iterator[Scene]:
    """Yield `per_seed` standard scenes of each board and seed, all different."""
    for seed in seeds:
        for index in range(per_seed):
            for columns, rows in boards:
                drawn = np.random.SeedSequence([seed, index, columns, rows]).generate_state(1)
                yield standard_scene(standard_target(columns, rows), int(drawn[0]))


def without_board(scene: Scene) -> np.ndarray:
    """Return an image of a scene's surroundings alone: light, clutter and noise, without the board."""
    levels = background(scene) * illumination(scene)
    levels += np.random.default_rng([scene.seed, 2]).normal(0.0, scene.noise_levels, levels.shape)
    return np.asarray(np.clip(np.rint(levels), 0, 255).astype(np.uint8))
