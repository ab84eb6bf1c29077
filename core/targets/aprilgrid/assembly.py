"""One AprilGrid from the lattices its tags were read in.

An obstacle in front of the grid may cut it into several lattices; they are merged to one grid if the plane through
the nearest tags of one agrees with the other. Tags next to those found, whose corners were not linked, are searched
for where the nearest tags predict them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from core.errors import TargetMirrored, TargetMismatch
from core.geometry import find_homography, map_in_front
from core.targets.aprilgrid.layout import AprilGridLayout
from core.targets.aprilgrid.tag_edge import check_tag_edge
from core.targets.aprilgrid.tag_lattice import MAX_HAMMING, TagLattice, hamming_distances

MIN_TAGS = 2
_MAX_CONTRADICTING = 0.1  # of the tags that agree: a sticker, but no other sheet
_FITS = 0.3  # of a tag's side: how far a tag may be from where its neighbours predict it
_NEAREST = 4  # tags that place another one
_CLOCKWISE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])


@dataclass(frozen=True, slots=True)
class TagGrid:
    """A grid in an image: the decoded tags, with their corners (px) from the upper left clockwise.

    The corners of those `completed` are where other tags predict them, by the stated layout.
    """

    layout: AprilGridLayout
    tags: dict[int, Float[np.ndarray, "4 2"]] = field(default_factory=dict)
    completed: set[int] = field(default_factory=set)

    def is_all_in_view(self, shape: tuple[int, ...]) -> bool:
        """Return whether every tag that is predicted to lie wholly in the image was decoded."""
        missing = self._missing()
        if len(self.tags) < MIN_TAGS or len(missing) == 0:
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
        predicted = np.full(wanted.shape, np.nan)
        for k in range(len(places)):
            H = find_homography(ideal[k], seen[k])
            if H is not None:
                predicted[k] = map_in_front(H, wanted[k])
        return predicted

    def complete(self, image: Shaped[np.ndarray, "h w"]) -> None:
        """Add the tags next to those found that are where the nearest ones predict them, until no more are found."""
        tried: set[int] = set()
        while self.tags:
            adjacent = [tag for tag in self._adjacent(self._missing()).tolist() if tag not in tried]
            tried.update(adjacent)
            if not adjacent:
                return
            places = self.predicted(np.array(adjacent))
            inside = _are_in(places, image.shape)
            tags, places = np.array(adjacent)[inside], places[inside]
            if len(tags):
                gap, codes = self.layout.gap_mm / self.layout.tag_mm, self.layout.tag_codes[tags]
                is_there = hamming_distances(image, gap, codes, places) <= MAX_HAMMING
                self.tags.update(zip(tags[is_there].tolist(), places[is_there], strict=True))
                self.completed.update(tags[is_there].tolist())

    def check_tag_edge(self, shape: tuple[int, ...]) -> None:
        """Raise TargetMismatch where tags, by the corners found in the image, are wider or narrower than stated.

        Looked at are those that adjoin one another: what a lens does between tags that stand apart is taken for width.
        """
        linked = np.array([tag for tag in self.tags if tag not in self.completed], dtype=np.intp)
        if len(linked) < MIN_TAGS:
            return
        column, row = self.layout.tag_places[linked].T
        is_linked = np.zeros((row.max() + 1, column.max() + 1), np.uint8)
        is_linked[row, column] = 1
        group = cv2.connectedComponents(is_linked, connectivity=8)[1][row, column]
        adjoining = linked[group == np.bincount(group).argmax()].tolist()
        points = TagGrid(self.layout, {tag: self.tags[tag] for tag in adjoining}).grid_points(shape)
        check_tag_edge(self.layout, *points)

    @property
    def is_verified(self) -> bool:
        """Whether tags of two rows were decoded: a single row does not determine how many columns the sheet has."""
        return len(np.unique(self.layout.tag_places[sorted(self.tags), 1])) > 1

    def grid_points(
        self, shape: tuple[int, ...]
    ) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
        """Return column, row and place (px) of the corners of the decoded tags that lie in the image."""
        places = self.layout.tag_places[list(self.tags)]
        column, row = (2 * places[:, None] + _CLOCKWISE).reshape(-1, 2).T
        points = np.array(list(self.tags.values())).reshape(-1, 2)
        inside = np.all((points >= 0.0) & (points <= [shape[1] - 1.0, shape[0] - 1.0]), axis=1)
        order = np.lexsort((column, row))
        order = order[inside[order]]
        return column[order], row[order], points[order]

    def _missing(self) -> Int[np.ndarray, " k"]:
        return np.array([tag for tag in range(len(self.layout.tag_places)) if tag not in self.tags], np.intp)

    def _adjacent(self, tags: Int[np.ndarray, " k"]) -> Int[np.ndarray, " m"]:
        """Return those of the tags that are adjacent to one found, diagonally too."""
        places = self.layout.tag_places
        apart = np.abs(places[tags][:, None] - places[sorted(self.tags)]).max(axis=2)
        return tags[apart.min(axis=1, initial=2) <= 1]


def assemble(
    parts: Sequence[TagLattice], image: Shaped[np.ndarray, "h w"], layout: AprilGridLayout
) -> TagGrid:
    """Return the grid that the lattices are parts of; without tags where none were read.

    Raises TargetMismatch where they are parts of another one or of several, TargetMirrored of a mirrored one.
    """
    found = TagGrid(layout)
    for part in sorted(parts, key=lambda p: -len(p.tags)):
        agreeing, others = len(part.tags), part.conflicting
        if part.displaced and agreeing >= MIN_TAGS:  # beyond a tear they are where they belong
            others -= int(np.count_nonzero(_are_near(part.displaced, TagGrid(layout, part.tags))))
        if others > _MAX_CONTRADICTING * agreeing:
            raise TargetMismatch(
                f"AprilTags are in view, but {others} of {agreeing + others} are not where a grid of "
                f"{layout.target.columns} x {layout.target.rows} has them.",
                "Check the target's columns and rows, which count tags, and that the sheet is laid out as Kalibr's: "
                "ids from 0 at the lower left, row by row upward.",
            )
        if agreeing == 0:
            continue
        if not found.tags or _are_near(part.tags, found).all():
            found.tags.update({tag: corners for tag, corners in part.tags.items() if tag not in found.tags})
        elif agreeing >= MIN_TAGS:
            found.check_tag_edge(image.shape)
            raise TargetMismatch(
                f"{agreeing} tags of the AprilGrid are in view that do not fit the grid found.",
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


def _are_near(seen_px: Mapping[int, Float[np.ndarray, "4 2"]], found: TagGrid) -> Bool[np.ndarray, " k"]:
    """Return which tags, by growing number, are where those found predict them."""
    tags = np.array(sorted(seen_px))
    seen = np.array([seen_px[int(tag)] for tag in tags])
    places = found.layout.tag_places
    far = np.abs(places[tags][:, None] - places[sorted(found.tags)]).max(axis=2).min(axis=1)
    off = np.linalg.norm(found.predicted(tags).mean(axis=1) - seen.mean(axis=1), axis=1)
    side = np.linalg.norm(seen - np.roll(seen, -1, axis=1), axis=2).min(axis=1)
    # of tags far away the lens's distortion leaves more
    return np.asarray(off < _FITS * side * np.maximum(far, 1.0))


def _are_in(places: Float[np.ndarray, "k 4 2"], shape: tuple[int, ...]) -> Bool[np.ndarray, " k"]:
    """Return which tags lie wholly in the image."""
    return np.asarray(np.all((places > 0.0) & (places < [shape[1] - 1.0, shape[0] - 1.0]), axis=(1, 2)))
