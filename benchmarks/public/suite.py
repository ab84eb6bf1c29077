"""The suite: which scenes are rendered. One factor at a time departs from the base scene, and once all of them do."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from core import TargetSpec
from core.geometry import Camera, project, transform_points
from core.simulation import Light, Scene, random_pose
from core.targets import charuco_layout

SIZE_PX = (1280, 1024)
LENSES = {
    "none": Camera(1200.0, 1200.0, 645.0, 508.0),
    "mild": Camera(1200.0, 1200.0, 645.0, 508.0, k1=-0.1, k2=0.05),
    "wide": Camera(750.0, 750.0, 645.0, 508.0, k1=-0.28, k2=0.08),
}
TARGETS = {
    "chessboard 9x6": TargetSpec("chessboard", 9, 6, 30.0),
    "chessboard 14x10": TargetSpec("chessboard", 14, 10, 20.0),
    "ChArUco 9x6, tags 36h11": TargetSpec("charuco", 9, 6, 30.0, 22.0, "DICT_APRILTAG_36h11"),
    "AprilGrid 6x6": TargetSpec("aprilgrid", 6, 6, 45.5, 35.0),
}
SEEDS = (1, 2, 3)
FACTORS = ("base", "blur", "noise", "tilt", "lens", "occlusion", "all at once")


@dataclass(frozen=True, slots=True)
class Condition:
    """What a scene is like: blur (px, standard deviation), noise (grey levels of 255), tilt (degrees), the lens (a key
    of `LENSES`) and the fraction of the grid points that something opaque hides."""

    factor: str = "base"
    blur_px: float = 1.0
    noise_levels: float = 4.0
    tilt_deg: float = 25.0
    lens: str = "mild"
    occluded: float = 0.0

    @property
    def level(self) -> str:
        """The value that departs from the base scene."""
        values = {
            "blur": f"{self.blur_px:g} px",
            "noise": f"{self.noise_levels:g} levels",
            "tilt": f"{self.tilt_deg:g}°",
            "lens": self.lens,
            "occlusion": f"{100 * self.occluded:g} %",
        }
        return values.get(self.factor, "")


CONDITIONS = (
    Condition(),
    *(Condition("blur", blur_px=value) for value in (0.5, 2.0, 3.0)),
    *(Condition("noise", noise_levels=value) for value in (8.0, 16.0)),
    *(Condition("tilt", tilt_deg=value) for value in (0.0, 45.0, 60.0)),
    *(Condition("lens", lens=value) for value in ("none", "wide")),
    *(Condition("occlusion", occluded=value) for value in (0.1, 0.25)),
    Condition("all at once", 2.0, 8.0, 45.0, "wide", 0.1),
)
_CLEAR_PX, _CLEAR_BLURS = 3.0, 4.0


@dataclass(frozen=True, slots=True)
class Disc:
    """Something opaque in front of the target: a disc of one grey level in the image."""

    centre_px: np.ndarray
    radius_px: float
    grey_level: float


@dataclass(frozen=True, slots=True)
class Item:
    """One image of the suite and its truth."""

    target_name: str
    condition: Condition
    seed: int
    scene: Scene
    disc: Disc | None

    @property
    def truth_px(self) -> np.ndarray:
        """True places of all labels: grid points row by row, then of a ChArUco board four corners of each marker."""
        return project(
            transform_points(self.scene.T_camera_target, labelled_points(self.scene.target)),
            self.scene.camera,
        )

    @property
    def visible(self) -> np.ndarray:
        """Which of them nothing hides, nor the blurred edge of what does."""
        truth = self.truth_px
        inside = np.all((truth > 0.0) & (truth < np.array(SIZE_PX) - 1.0), axis=1)
        if self.disc is None:
            return np.asarray(inside)
        away = np.linalg.norm(truth - self.disc.centre_px, axis=1) - self.disc.radius_px
        return np.asarray(inside & (away > _CLEAR_PX + _CLEAR_BLURS * self.scene.blur_px))


def labelled_points(target: TargetSpec) -> np.ndarray:
    """Return the points (n, 3), mm, that a detector may deliver, in the order of their labels."""
    points = target.points_target()
    if target.kind != "charuco":
        return points
    layout = charuco_layout(target)
    numbers = range(len(layout.marker_squares))
    return np.concatenate([points, *(layout.marker_corners(number) for number in numbers)])


def items(
    targets: dict[str, TargetSpec] = TARGETS,
    conditions: tuple[Condition, ...] = CONDITIONS,
    seeds: tuple[int, ...] = SEEDS,
) -> Iterator[Item]:
    """Yield every image of the suite: each target in each condition with each seed.

    The seed alone draws pose, light and clutter of a target: a factor's images show the base scene's, as far as the
    factor leaves it.
    """
    for name, target in targets.items():
        for condition in conditions:
            for seed in seeds:
                yield _item(name, target, condition, seed)


def _item(name: str, target: TargetSpec, condition: Condition, seed: int) -> Item:
    drawn = [seed, target.size, target.kind == "charuco"]
    rng = np.random.default_rng([*drawn, 1])
    light = Light(
        black_level=float(rng.uniform(20, 40)),
        white_level=float(rng.uniform(170, 210)),
        gradient=(float(rng.uniform(-0.2, 0.2)), float(rng.uniform(-0.2, 0.2))),
        vignetting=float(rng.uniform(0.05, 0.3)),
    )
    camera, tilt = LENSES[condition.lens], math.radians(condition.tilt_deg)
    pose_rng = np.random.default_rng([*drawn, 2])
    scene = Scene(
        target=target,
        camera=camera,
        T_camera_target=random_pose(target, camera, SIZE_PX, tilt, math.radians(40.0), pose_rng),
        width_px=SIZE_PX[0],
        height_px=SIZE_PX[1],
        blur_px=condition.blur_px,
        noise_levels=condition.noise_levels,
        light=light,
        clutter=1.0,
        seed=seed,
        background_seed=seed,
    )
    item = Item(name, condition, seed, scene, None)
    return item if condition.occluded == 0.0 else replace(item, disc=_disc(item, rng))


def _disc(item: Item, rng: np.random.Generator) -> Disc:
    """Return a disc about one of the grid's outer corners that hides the stated fraction of its points."""
    scene = item.scene
    points = scene.points_px
    rows, columns = scene.target.grid_rows, scene.target.grid_columns
    corners = np.array([0, columns - 1, (rows - 1) * columns, rows * columns - 1])
    centre = points[rng.choice(corners)]
    away = np.sort(np.linalg.norm(points - centre, axis=1))
    hidden = max(1, round(item.condition.occluded * len(points)))
    radius = 0.5 * float(away[hidden - 1] + away[hidden])
    return Disc(centre, radius, float(rng.uniform(60.0, 150.0)))
