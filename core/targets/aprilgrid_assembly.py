"""One AprilGrid from the lattices its tags were read in.

What is in front of the grid may cut it in several lattices; they are one grid where the plane through the nearest tags
of one is that of the other. Tags beside those found, whose corners were not linked, are looked for where the nearest
ones predict them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from core.errors import TargetMirrored, TargetMismatch
from core.targets.aprilgrid_layout import AprilGridLayout
from core.targets.aprilgrid_reading import MOST_WRONG_BITS, LatticePart, wrong_bits

LEAST_TAGS = 2
_MOST_CONTRADICTING = 0.1  # of the tags that agree: a sticker, but no other sheet
_FITS = 0.3  # of a tag's side: how far a tag may be from where its neighbours predict it
_NEAREST = 4  # tags that place another one
_CLOCKWISE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])


@dataclass(frozen=True, slots=True)
class FoundGrid:
    """A grid in a picture: the tags read, with their corners (px) from the upper left clockwise."""

    layout: AprilGridLayout
    tags: dict[int, Float[np.ndarray, "4 2"]] = field(default_factory=dict)

    def is_all_in_view(self, shape: tuple[int, ...]) -> bool:
        """Tell whether every tag of the grid that is wholly in the picture was read, as far as these predict them."""
        missing = self._missing()
        if len(self.tags) < LEAST_TAGS or len(missing) == 0:
            return len(missing) == 0
        return not bool(_are_in(self.predicted(missing), shape).any())

    def predicted(self, tags: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k 4 2"]:
        """Return the corners of tags (px) by the planes through those nearest to them; NaN behind the camera."""
        places, known = self.layout.tag_places[tags], np.array(sorted(self.tags))
        apart = self.layout.tag_places[known] - places[:, None]
        nearest = known[np.argsort((apart**2).sum(axis=2), axis=1, kind="stable")[:, :_NEAREST]]
        corners = np.array([self.layout.tag_corners(int(tag))[:, :2] for tag in known])
        pixels = np.array([self.tags[int(tag)] for tag in known])
        at = np.searchsorted(known, nearest)
        ideal, seen = (a[at].reshape(len(places), -1, 2) for a in (corners, pixels))
        wanted = places[:, None] * self.layout.target.pitch_mm + _CLOCKWISE * self.layout.tag_mm
        return _through_planes(ideal, seen, wanted)

    def complete(self, image: Shaped[np.ndarray, "h w"]) -> None:
        """Add the tags beside those found that are where the nearest ones predict them, until there are none."""
        tried: set[int] = set()
        while self.tags:
            beside = [tag for tag in self._beside(self._missing()).tolist() if tag not in tried]
            tried.update(beside)
            if not beside:
                return
            places = self.predicted(np.array(beside))
            inside = _are_in(places, image.shape)
            tags, places = np.array(beside)[inside], places[inside]
            if len(tags):
                gap, codes = self.layout.gap_mm / self.layout.tag_mm, self.layout.tag_codes[tags]
                is_there = wrong_bits(image, gap, codes, places) <= MOST_WRONG_BITS
                self.tags.update(zip(tags[is_there].tolist(), places[is_there], strict=True))

    @property
    def is_certain(self) -> bool:
        """Whether tags of two rows were read: of one row alone nothing tells how many columns the sheet has."""
        return len(np.unique(self.layout.tag_places[sorted(self.tags), 1])) > 1

    def grid_points(
        self, shape: tuple[int, ...]
    ) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
        """Return column, row and place (px) of the corners in the picture of the tags read."""
        places = self.layout.tag_places[list(self.tags)]
        column, row = (2 * places[:, None] + _CLOCKWISE).reshape(-1, 2).T
        points = np.array(list(self.tags.values())).reshape(-1, 2)
        inside = np.all((points >= 0.0) & (points <= [shape[1] - 1.0, shape[0] - 1.0]), axis=1)
        order = np.lexsort((column, row))
        order = order[inside[order]]
        return column[order], row[order], points[order]

    def _missing(self) -> Int[np.ndarray, " k"]:
        return np.array([tag for tag in range(len(self.layout.tag_places)) if tag not in self.tags], np.intp)

    def _beside(self, tags: Int[np.ndarray, " k"]) -> Int[np.ndarray, " m"]:
        """Return those of the tags that stand beside one found, across a corner too."""
        places = self.layout.tag_places
        apart = np.abs(places[tags][:, None] - places[sorted(self.tags)]).max(axis=2)
        return tags[apart.min(axis=1, initial=2) <= 1]


def assemble(
    parts: Sequence[LatticePart], image: Shaped[np.ndarray, "h w"], layout: AprilGridLayout
) -> FoundGrid:
    """Return the grid that the lattices are parts of; without tags where none were read.

    Raises TargetMismatch where they are parts of another one or of several, TargetMirrored of a mirrored one.
    """
    found = FoundGrid(layout)
    for part in sorted(parts, key=lambda p: -len(p.tags)):
        agreeing, others = len(part.tags), part.contradicting
        if others > _MOST_CONTRADICTING * agreeing:
            raise TargetMismatch(
                f"AprilTags are in view, but {others} of {agreeing + others} are not where a grid of "
                f"{layout.target.columns} x {layout.target.rows} has them.",
                "Check the target's columns and rows, which count tags, and that the sheet is laid out as Kalibr's: "
                "ids from 0 at the lower left, row by row upward.",
            )
        if agreeing == 0:
            continue
        if not found.tags or _fits(part, found):
            found.tags.update({tag: corners for tag, corners in part.tags.items() if tag not in found.tags})
        elif agreeing >= LEAST_TAGS:
            raise TargetMismatch(
                f"{agreeing} tags of the AprilGrid are in view beside others that belong to it.",
                "Cover other sheets with the same tags, and mirrors.",
            )
    if any(part.is_mirrored for part in parts):
        if not found.tags:
            raise TargetMirrored("The AprilGrid's tags are in view, but mirrored.")
        raise TargetMismatch(
            "The AprilGrid's tags are in view twice, once mirrored.",
            "Cover mirrors, and sheets with the same tags.",
        )
    found.complete(image)
    return found


def _fits(part: LatticePart, found: FoundGrid) -> bool:
    """Tell whether a lattice's tags are where those found predict them."""
    tags = np.array(sorted(part.tags))
    seen = np.array([part.tags[int(tag)] for tag in tags])
    places = found.layout.tag_places
    far = np.abs(places[tags][:, None] - places[sorted(found.tags)]).max(axis=2).min(axis=1)
    off = np.linalg.norm(found.predicted(tags).mean(axis=1) - seen.mean(axis=1), axis=1)
    side = np.linalg.norm(seen - np.roll(seen, -1, axis=1), axis=2).min(axis=1)
    # of tags far away the lens's distortion leaves more
    return bool(np.all(off < _FITS * side * np.maximum(far, 1.0)))


def _are_in(places: Float[np.ndarray, "k 4 2"], shape: tuple[int, ...]) -> Bool[np.ndarray, " k"]:
    """Tell which tags are wholly in the picture."""
    return np.asarray(np.all((places > 0.0) & (places < [shape[1] - 1.0, shape[0] - 1.0]), axis=(1, 2)))


def _through_planes(
    ideal: Float[np.ndarray, "k m 2"], seen: Float[np.ndarray, "k m 2"], wanted: Float[np.ndarray, "k 4 2"]
) -> Float[np.ndarray, "k 4 2"]:
    """Return the pictures of the wanted places by the homographies of ideal to seen ones, NaN behind the camera.

    By the direct linear transform, both normalised.
    """
    (x, x_middle, x_size), (p, p_middle, p_size) = _normalised(ideal), _normalised(seen)
    one, none = np.ones((*x.shape[:2], 1)), np.zeros((*x.shape[:2], 3))
    X = np.concatenate([x, one], axis=2)
    A = np.concatenate(
        [
            np.concatenate([X, none, -p[..., :1] * X], axis=2),
            np.concatenate([none, X, -p[..., 1:] * X], axis=2),
        ],
        axis=1,
    )
    H = np.linalg.eigh(A.transpose(0, 2, 1) @ A)[1][:, :, 0].reshape(-1, 3, 3)
    H = H * np.where(H[:, 2, 2] > 0.0, 1.0, -1.0)[:, None, None]  # before the camera in the middle
    w = (wanted - x_middle) / x_size
    ahead = np.concatenate([w, np.ones((*w.shape[:2], 1))], axis=2) @ H.transpose(0, 2, 1)
    depth = np.where(ahead[..., 2:] > 1e-9, ahead[..., 2:], np.nan)
    return np.asarray(ahead[..., :2] / depth * p_size + p_middle)


def _normalised(
    points: Float[np.ndarray, "k m 2"],
) -> tuple[Float[np.ndarray, "k m 2"], Float[np.ndarray, "k 1 2"], Float[np.ndarray, "k 1 1"]]:
    """Return the points about their middle in units of their spread, the middle, and the spread."""
    middle = points.mean(axis=1, keepdims=True)
    size = np.sqrt(np.mean((points - middle) ** 2, axis=(1, 2), keepdims=True))
    return (points - middle) / size, middle, size
