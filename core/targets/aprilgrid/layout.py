"""Where an AprilGrid's tags stand, what is printed in them, and how the target frame lies to Kalibr's.

The sheet is Kalibr's: square tags of the family 36h11 with a black border two cells wide, `marker_mm` from edge to edge
and `pitch_mm` from tag to tag (Kalibr's tagSize and tagSize (1 + tagSpacing)); a black square fills each crossing of
the gaps, also beyond the outermost tags, so that four squares meet at every corner of a tag.

Kalibr's frame has its origin at the lower left, where id 0 is when the tags stand upright, x to the right, y upward and
z out of the sheet; ids count along x, row by row along y. The target frame has z into the board, as every target's, and
keeps Kalibr's y: x runs the other way. So it is that of the sheet upside down, seen as usual with x to the right and y
down: id 0 is at the upper *right*, and grid point (0, 0), the upper left, is the corner of the last id of the first
row. With W = (columns - 1) pitch + marker, Kalibr's (x, y, z) are (W - x, y, -z) of the target frame. Where a tag is
depends on its id and on `columns`, which the ids of two rows prove, and not on how many rows a sheet is said to have.

Upside down the tags look as OpenCV draws them (`DICT_APRILTAG_36h11`), which is upside down against the family's own
images, and Kalibr's.

References: E. Olson, "AprilTag: A robust and flexible visual fiducial system", ICRA 2011,
10.1109/ICRA.2011.5979561; P. Furgale, J. Rehder, R. Siegwart, "Unified temporal and spatial calibration for
multi-sensor systems", IROS 2013, 10.1109/IROS.2013.6696514; Kalibr's wiki, "Calibration targets".
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from core.errors import InvalidTarget
from core.targets.markers import marker_bits
from core.targets.specification import TargetSpec

DICTIONARY = "DICT_APRILTAG_36h11"
CODE_CELLS, BORDER_CELLS = 6, 2
TAG_CELLS = CODE_CELLS + 2 * BORDER_CELLS
MIN_GAP_RATIO, MAX_GAP_RATIO = 0.1, 1.0
"""Of a tag's edge (Kalibr's tagSpacing): narrower ones blur shut, wider ones Kalibr does not print."""
_ROUNDING = 1e-5  # so that the limits may be met in the six figures in which they are stated
_MEASURE = (
    "Measure a tag from black edge to black edge for marker_mm (Kalibr's tagSize), and from there to the same edge of "
    "the next tag for pitch_mm, tagSize (1 + tagSpacing)."
)


@dataclass(frozen=True, slots=True)
class AprilGridLayout:
    """The tags of one sheet.

    Tag k has id k and is the `tag_places[k]` = (i, j): i-th along x, j-th along y. `tag_codes` (tags, 6, 6) are the
    cells inside its border, rows along y and columns along x, True where white.
    """

    target: TargetSpec
    tag_mm: float
    tag_places: Int[np.ndarray, "k 2"]
    tag_codes: Bool[np.ndarray, "k 6 6"]

    @property
    def gap_mm(self) -> float:
        """Width of the white gaps, and of the black squares in their crossings."""
        return self.target.pitch_mm - self.tag_mm

    def tag_corners(self, tag: int) -> Float[np.ndarray, "4 3"]:
        """Return a tag's corners in the target frame, mm: from its upper left, clockwise as seen."""
        if not 0 <= tag < len(self.tag_places):
            raise InvalidTarget(f"The grid has tags 0 to {len(self.tag_places) - 1}, not {tag}.")
        i, j = self.tag_places[tag]
        origin = np.array([i, j, 0.0]) * self.target.pitch_mm
        square = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
        return np.asarray(origin + self.tag_mm * square)


def aprilgrid_layout(target: TargetSpec) -> AprilGridLayout:
    """Return the layout of a target of kind `aprilgrid`.

    Raises InvalidTarget for another kind, another family of tags or one that is unknown, more tags than the family has,
    and tags whose gaps are too narrow or too wide.
    """
    if target.kind != "aprilgrid":
        raise InvalidTarget(f"A target of kind {target.kind!r} has no AprilTags.")
    _check_dictionary(target.dictionary)
    tag_mm = _tag_mm(target)
    count = target.columns * target.rows
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    available = len(dictionary.bytesList)
    if count > available:
        raise InvalidTarget(
            f"The grid of {target.columns} x {target.rows} needs {count} tags, the family 36h11 has {available}.",
            f"columns and rows count tags, not their corners; columns times rows may be {available} at most.",
            field="columns" if target.columns >= target.rows else "rows",
        )
    j, from_right = np.divmod(np.arange(count), target.columns)
    return AprilGridLayout(
        target=target,
        tag_mm=float(tag_mm),
        tag_places=np.stack([target.columns - 1 - from_right, j], axis=1),
        tag_codes=marker_bits(DICTIONARY)[:count],
    )


def _check_dictionary(name: str | None) -> None:
    if name in (None, DICTIONARY, DICTIONARY.upper()):  # OpenCV has both spellings
        return
    kept = f"Leave dictionary out, or set it to {DICTIONARY}. Boards with other markers are of kind charuco."
    if not str(name).startswith("DICT_") or not hasattr(cv2.aruco, str(name)):
        raise InvalidTarget(f"Unknown marker dictionary {name!r}.", kept, field="dictionary")
    raise InvalidTarget(
        f"An AprilGrid has tags of the family 36h11, not of {name}.", kept, field="dictionary"
    )


def _tag_mm(target: TargetSpec) -> float:
    """Return a tag's edge, mm. Raises InvalidTarget where it is not stated or leaves no gap that can be seen."""
    tag_mm = target.marker_mm
    if tag_mm is None:
        raise InvalidTarget("marker_mm is required for AprilGrids.", _MEASURE, field="marker_mm")
    if not 0.0 < tag_mm < math.inf:
        raise InvalidTarget(
            f"An AprilGrid's marker_mm must be a positive length, got {tag_mm!r}.",
            _MEASURE,
            field="marker_mm",
        )
    gap = (target.pitch_mm - tag_mm) / tag_mm
    if MIN_GAP_RATIO - _ROUNDING <= gap <= MAX_GAP_RATIO + _ROUNDING:
        return float(tag_mm)
    least, most = ((1.0 + share) * tag_mm for share in (MIN_GAP_RATIO, MAX_GAP_RATIO))
    wrong = f"An AprilGrid's gaps must be {MIN_GAP_RATIO:g} to {MAX_GAP_RATIO:g} of a tag's edge wide, got {gap:.3g}."
    if gap <= 0.0:
        wrong = (
            f"An AprilGrid's marker_mm must be less than its pitch_mm of {target.pitch_mm:g}, got {tag_mm:g}."
        )
    raise InvalidTarget(
        wrong, f"{_MEASURE} With tags of {tag_mm:g} mm it is {least:.6g} to {most:.6g} mm.", field="marker_mm"
    )
