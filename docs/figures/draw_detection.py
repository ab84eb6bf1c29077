"""Draw the figures of docs/detection.md: `python docs/figures/draw_detection.py [--seed 7] [--into docs/figures]`.

What is drawn is what the detector did with a rendered scene: its own trace, and its result against the truth.
"""

from __future__ import annotations

import argparse
import math
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from core.simulation import Scene, render
from core.targets import Step, detect, trace_detection
from tests.support.simulation.scenes import standard_scene, standard_target

SHOWN_PX = 1000  # width of the figures
MAGNIFIED = 2500.0  # how much longer than they are errors are drawn
SUBPIX_WINDOW = (11, 11)
SUBPIX_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
FRACTION = 4  # bits of the drawing functions' sub-pixel coordinates
GREEN, RED, BLUE, ORANGE, GREY = (0, 150, 0), (40, 40, 220), (200, 90, 0), (0, 140, 255), (150, 150, 150)


class Sheet:
    """A canvas with the image reduced and paler; drawing functions take full-resolution pixels."""

    def __init__(self, image: np.ndarray, pale: float) -> None:
        self.scale = SHOWN_PX / image.shape[1]
        size = (SHOWN_PX, round(image.shape[0] * self.scale))
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float64)
        self.canvas = cv2.cvtColor((small * (1.0 - pale) + 255.0 * pale).astype(np.uint8), cv2.COLOR_GRAY2BGR)

    def line(
        self, start: np.ndarray, end: np.ndarray, colour: tuple[int, int, int], thickness: int = 1
    ) -> None:
        cv2.line(self.canvas, self._at(start), self._at(end), colour, thickness, cv2.LINE_AA, shift=FRACTION)

    def circle(
        self, centre: np.ndarray, radius: float, colour: tuple[int, int, int], thickness: int = 1
    ) -> None:
        size = round(radius * (1 << FRACTION))
        cv2.circle(self.canvas, self._at(centre), size, colour, thickness, cv2.LINE_AA, shift=FRACTION)

    def legend(self, entries: list[tuple[str, tuple[int, int, int]]]) -> None:
        height = 26 * len(entries) + 12
        bottom = self.canvas.shape[0]
        cv2.rectangle(self.canvas, (0, bottom - height), (470, bottom), (255, 255, 255), cv2.FILLED)
        for index, (text, colour) in enumerate(entries):
            v = bottom - height + 26 * index + 24
            cv2.circle(self.canvas, (16, v - 5), 6, colour, cv2.FILLED, cv2.LINE_AA)
            cv2.putText(self.canvas, text, (32, v), cv2.FONT_HERSHEY_SIMPLEX, 0.55, (0, 0, 0), 1, cv2.LINE_AA)

    def _at(self, place: np.ndarray) -> tuple[int, int]:
        u, v = ((np.asarray(place) + 0.5) * self.scale - 0.5) * (1 << FRACTION)
        return round(float(u)), round(float(v))


def draw_candidates(image: np.ndarray, step: Step) -> np.ndarray:
    """Every corner found on the level that had the board, with the four edges that leave it."""
    sheet = Sheet(image, pale=0.45)
    reach = 7.0 / sheet.scale
    for place, rays in zip(step.level.to_full(step.saddles.points), step.saddles.rays, strict=True):
        for number, ray in enumerate(rays):
            sheet.line(place, place + reach * ray, ORANGE if number % 2 == 0 else BLUE, 2)
    sheet.legend(
        [("edge with the bright square after it", ORANGE), ("edge with the dark square after it", BLUE)]
    )
    return sheet.canvas


def draw_lattice(image: np.ndarray, step: Step, grid: np.ndarray) -> np.ndarray:
    """The links that two corners agree on, and the lattice grown from them."""
    sheet = Sheet(image, pale=0.45)
    places = step.level.to_full(step.saddles.points)
    for lines in (grid, np.swapaxes(grid, 0, 1)):
        for line in lines:
            for start, end in pairwise(line):
                if np.all(np.isfinite([start, end])):
                    sheet.line(start, end, GREEN, 2)
    for corner, others in enumerate(step.patches.links):
        for other in others[others > corner]:
            sheet.line(places[corner], places[other], ORANGE)
    for place, patch in zip(places, step.patches.patch, strict=True):
        sheet.circle(place, 4.0, ORANGE if patch >= 0 else GREY, cv2.FILLED)
    for place in grid.reshape(-1, 2):
        if np.all(np.isfinite(place)):
            sheet.circle(place, 6.0, GREEN)
    sheet.legend(
        [
            ("corner that no other one links back to", GREY),
            ("linked corners", ORANGE),
            ("the lattice, grown on the full image", GREEN),
        ]
    )
    return sheet.canvas


def draw_residuals(image: np.ndarray, scene: Scene) -> np.ndarray:
    """Errors of the refined corners against the truth, and those of cv2.cornerSubPix from the same start."""
    found = detect(image, scene.target)
    truth = scene.points_px[found.row * scene.target.columns + found.column]
    start = found.points_px.astype(np.float32).reshape(-1, 1, 2)
    theirs = cv2.cornerSubPix(image, start, SUBPIX_WINDOW, (-1, -1), SUBPIX_STOP).reshape(-1, 2)
    sheet = Sheet(image, pale=0.6)
    for place, mine, other, u in zip(
        truth, found.points_px, theirs, found.standard_uncertainty_px, strict=True
    ):
        sheet.circle(place, 2.0 * u * MAGNIFIED * sheet.scale, GREEN)
        sheet.line(place, place + MAGNIFIED * (other - place), RED, 2)
        sheet.line(place, place + MAGNIFIED * (mine - place), GREEN, 3)
    rms = [math.sqrt(float(np.mean(np.sum((p - truth) ** 2, axis=1)))) for p in (found.points_px, theirs)]
    sheet.legend(
        [
            (f"errors x {MAGNIFIED:.0f}, rms {rms[0]:.4f} px; circle: 2 u stated", GREEN),
            (f"cv2.cornerSubPix, window 11: rms {rms[1]:.4f} px", RED),
        ]
    )
    return sheet.canvas


def draw_all(seed: int, into: Path) -> list[Path]:
    """Write the three figures and return their paths."""
    scene = standard_scene(standard_target(9, 6), seed, tilt=math.radians(40.0))
    image = render(scene)
    trace = trace_detection(image, scene.target)
    if trace.lattice is None:
        raise SystemExit(f"The board of seed {seed} was not found; take another seed.")
    drawn = {
        "detection-candidates.png": draw_candidates(image, trace.steps[-1]),
        "detection-lattice.png": draw_lattice(image, trace.steps[-1], trace.lattice.grid),
        "detection-residuals.png": draw_residuals(image, scene),
    }
    into.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, canvas in drawn.items():
        path = into / name
        path.write_bytes(cv2.imencode(".png", canvas, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes())
        paths.append(path)
    return paths


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=7, help="of the rendered scene")
    parser.add_argument("--into", type=Path, default=Path(__file__).parent)
    arguments = parser.parse_args()
    for written in draw_all(arguments.seed, arguments.into):
        print(written)
