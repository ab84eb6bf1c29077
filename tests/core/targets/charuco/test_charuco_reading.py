"""Markers read where a lattice has them: the compiled parts against plain numpy, and every dictionary there is."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import pytest

from core.geometry.camera import Camera
from core.geometry.se3 import so3_exp, transform
from core.targets.charuco.layout import charuco_layout
from core.targets.charuco.placement import lattices_of, locate_on_board
from core.targets.lattice.lattice import Lattice
from core.targets.lattice.pyramid import levels
from core.targets.markers.bit_sampling import decode_markers
from core.targets.markers.dictionary import MarkerDictionary, code_of, marker_codes, nearest_markers
from core.targets.markers.square_places import mapped_squares, surrounded
from core.targets.printed_pattern import RectilinearPattern, pattern_of
from core.targets.specification import TargetSpec
from tests.support.simulation.quick_renderer import sheet_in_view

DICTIONARIES = sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_"))
CAMERA = Camera(900.0, 900.0, 319.5, 239.5, k1=-0.1)


def image_of(target: TargetSpec, turn: float = 0.4, blur_px: float = 0.8) -> np.ndarray:
    """A board tilted by 25° that fills most of 640 x 480 px, with a little noise."""
    pattern = pattern_of(target, 0.5)
    assert isinstance(pattern, RectilinearPattern)
    middle = target.points_target().mean(axis=0)
    R = so3_exp(0.44 * np.array([0.6, 0.8, 0.0])) @ so3_exp(np.array([0.0, 0.0, turn]))
    far = CAMERA.fx_px * np.hypot(target.columns + 1, target.rows + 1) * target.pitch_mm / 500.0
    ink, seen = sheet_in_view(
        pattern, CAMERA, transform(R, np.array([0.0, 0.0, far]) - R @ middle), (640, 480)
    )
    levels_ = cv2.GaussianBlur(100.0 * (1.0 - seen) + 40.0 * seen + 150.0 * ink, (0, 0), blur_px)
    noise = np.random.default_rng(5).normal(0.0, 2.0, levels_.shape)
    return np.clip(np.rint(levels_ + noise), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("name", DICTIONARIES)
def test_every_dictionary_is_read_in_both_layouts(name: str) -> None:
    """All 15 or so markers of a board, whichever way it lies; none of it is read of the same board mirrored."""
    codes = marker_codes(name)
    for legacy, turn in ((False, 0.4), (True, 2.2)):
        target = TargetSpec("charuco", 5, 3, 30.0, 21.0, name, legacy)
        layout = charuco_layout(target)
        image = image_of(target, turn)
        lattice = next(lattices_of(image, next(iter(levels(image))), layout))
        placed = locate_on_board(image, lattice, layout, codes)
        assert (placed.verdict, len(placed.column)) == ("placed", 15)
        assert sorted(placed.markers) == list(range(12))
        deep = locate_on_board(image.astype(np.uint16) * 257, lattice, layout, codes)
        assert sorted(deep.markers) == list(range(12))
    flipped = np.ascontiguousarray(image[:, ::-1])
    lattice = next(lattices_of(flipped, next(iter(levels(flipped))), layout))
    assert locate_on_board(flipped, lattice, layout, codes).verdict == "mirrored"


def test_blurred_cells_of_few_pixels_are_read() -> None:
    """Cells of 3 px under a blur of half a cell: more than three markers of four."""
    target = TargetSpec("charuco", 8, 6, 30.0, 18.0, "DICT_6X6_250")
    image = image_of(target, blur_px=1.5)
    layout = charuco_layout(target)
    lattice = next(lattices_of(image, next(iter(levels(image))), layout))
    placed = locate_on_board(image, lattice, layout, marker_codes("DICT_6X6_250"))
    assert placed.agreeing == placed.read
    assert placed.agreeing > 0.75 * len(layout.marker_squares)


def test_codes_are_the_bits_of_opencvs_images() -> None:
    for name in ("DICT_4X4_50", "DICT_7X7_50", "DICT_APRILTAG_36h11"):
        codes = marker_codes(name)
        known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
        for k in (0, 17, 29):
            cells = cv2.aruco.generateImageMarker(known, k, codes.side + 2) > 127
            assert not cells[0].any()
            for turn in range(4):
                bits = np.rot90(cells[1:-1, 1:-1], turn).ravel()
                assert codes.codes[turn, k] == sum(1 << n for n, bit in enumerate(bits[::-1]) if bit)


def test_fewer_markers_must_agree_the_more_bits_they_have() -> None:
    least = {name: marker_codes(name).least_agreeing for name in DICTIONARIES}
    assert min(least.values()) == 2
    assert max(least.values()) <= 5
    assert least["DICT_7X7_50"] <= least["DICT_5X5_1000"] <= least["DICT_4X4_1000"]


def test_nearest_markers_are_those_of_plain_counting() -> None:
    rng = np.random.default_rng(2)
    codes = marker_codes("DICT_5X5_100")
    read = codes.codes[rng.integers(0, 4, 60), rng.integers(0, 100, 60)]
    for k in range(0, 60, 2):
        read[k] ^= np.uint64(1 << int(rng.integers(25)))
    read[::7] = rng.integers(0, 1 << 25, len(read[::7])).astype(np.uint64)
    found = nearest_markers(read, codes.codes, codes.max_hamming)
    bits = (codes.codes[..., None] >> np.arange(25, dtype=np.uint64)) & np.uint64(1)
    for number, (marker, turn, distance) in zip(read, found, strict=True):
        own = (number >> np.arange(25, dtype=np.uint64)) & np.uint64(1)
        distances = (bits != own).sum(axis=2)
        if distances.min() <= codes.max_hamming:
            assert distance == distances.min() == distances[turn, marker]
        else:
            assert marker == -1
    assert (found[:, 0] >= 0).sum() > 40


def test_codes_keep_the_order_of_their_bits() -> None:
    bits = np.zeros((2, 3, 3), dtype=bool)
    bits[0, 0, 0] = bits[1, 2, 1] = bits[1, 2, 2] = True
    assert code_of(bits).tolist() == [256, 3]


def test_squares_are_mapped_as_by_opencv() -> None:
    rng = np.random.default_rng(1)
    y, x = np.mgrid[0:4, 0:5].astype(float)
    places = np.stack([40 * x + 6 * y + x * y, 35 * y - 4 * x], axis=2) + rng.normal(0.0, 1.5, (4, 5, 2))
    squares = np.array([(i - 1, j - 1) for i, j in itertools.product(range(4), range(3))])
    inside = rng.uniform(0.0, 1.0, (6, 2))
    mapped = mapped_squares(places, squares, inside)
    unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float32)
    for (i, j), points in zip(squares + 1, mapped, strict=True):
        corners = places[[j, j, j + 1, j + 1], [i, i + 1, i + 1, i]].astype(np.float32)
        H = cv2.getPerspectiveTransform(unit, corners)
        np.testing.assert_allclose(points, cv2.perspectiveTransform(inside[None], H)[0], atol=1e-3)
    folded = places.copy()
    folded[1, 1] = places[2, 2] + 30.0
    assert np.isnan(mapped_squares(folded, np.array([[0, 0]]), inside)).all()


def test_corners_around_a_lattice_are_foreseen() -> None:
    """A lattice bent by perspective, with holes: foreseen within a fiftieth of a square for the most part."""
    y, x = np.mgrid[-1:6, -1:8].astype(float)
    scale = 1.0 + 0.03 * x + 0.02 * y
    truth = np.stack([50 * x / scale, 45 * y / scale], axis=2)
    grid = truth[1:-1, 1:-1].copy()
    grid[2, 3] = grid[0, 4] = np.nan
    found = surrounded(grid)
    assert np.isfinite(found).all()
    known = np.pad(np.isfinite(grid[..., 0]), 1)
    np.testing.assert_array_equal(found[known], truth[known])
    off = np.linalg.norm(found - truth, axis=2)
    assert off[3, 4] < 1.0
    assert off.max() < 5.0
    assert np.median(off[~known]) < 1.0
    np.testing.assert_array_equal(surrounded(np.full((3, 4, 2), np.nan)), np.full((5, 6, 2), np.nan))


def plain_reading(
    image: np.ndarray, corners: np.ndarray, codes: MarkerDictionary, size: float
) -> np.ndarray | None:
    """The bits of one square by plain numpy and OpenCV; None without a black frame."""
    cells, margin = codes.side + 2, 0.5 * (1.0 - size)
    cell = size / cells
    H = cv2.getPerspectiveTransform(np.float32([[0, 0], [1, 0], [1, 1], [0, 1]]), corners.astype(np.float32))

    def seen(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        places = cv2.perspectiveTransform(np.stack([x.ravel(), y.ravel()], axis=1)[None], H)[0]
        (u, v), f = np.floor(places).astype(int).T, image.astype(float)
        fu, fv = (places - np.floor(places)).T
        upper = f[v, u] * (1 - fu) + f[v, u + 1] * fu
        lower = f[v + 1, u] * (1 - fu) + f[v + 1, u + 1] * fu
        return (upper * (1 - fv) + lower * fv).reshape(x.shape)

    along = (np.arange(6) + 0.5) / 6
    near, far = np.full(6, 0.5 * margin), np.full(6, 1.0 - 0.5 * margin)
    white = [seen(along, near), seen(along, far), seen(near, along), seen(far, along)]
    above, below, left, right = (float(side.mean()) for side in white)
    middle = margin + (np.arange(cells) + 0.5) * cell
    parts = [
        seen(*np.meshgrid(middle + du * cell, middle + dv * cell))
        for du in (-0.25, 0.0, 0.25)
        for dv in (-0.25, 0.0, 0.25)
    ]
    value = np.pad(np.mean(parts, axis=0), 1)
    ramp = ((np.arange(cells) + 0.5) / cells - 0.5) * size / (1.0 - margin)
    value[0, 1:-1], value[-1, 1:-1] = above + ramp * (right - left), below + ramp * (right - left)
    value[1:-1, 0], value[1:-1, -1] = left + ramp * (below - above), right + ramp * (below - above)
    own = value[1:-1, 1:-1]
    around = value[:-2, 1:-1] + value[2:, 1:-1] + value[1:-1, :-2] + value[1:-1, 2:]
    sharp = own + 0.3 * (4.0 * own - around)
    black = [sharp[0].mean(), sharp[-1].mean(), sharp[:, 0].mean(), sharp[:, -1].mean()]
    x, y = np.meshgrid((np.arange(cells) + 0.5) / cells - 0.5, (np.arange(cells) + 0.5) / cells - 0.5)
    limit = 0.125 * (above + below + left + right + sum(black))
    limit = limit + 0.5 * size / (1.0 - margin) * (x * (right - left) + y * (below - above))
    limit = limit + 0.5 * cells / (cells - 1.0) * (x * (black[3] - black[2]) + y * (black[1] - black[0]))
    bits = sharp > limit
    frame = bits.sum() - bits[1:-1, 1:-1].sum()
    contrast = 0.25 * (above + below + left + right - sum(black))
    return bits[1:-1, 1:-1] if frame <= 0.2 * 4 * (cells - 1) and contrast > 3.0 else None


def test_squares_are_read_as_by_plain_numpy() -> None:
    """On a board in uneven light, and on noise: the same squares have a frame, and the same bits."""
    target = TargetSpec("charuco", 6, 4, 30.0, 22.0, "DICT_5X5_100")
    codes, size = marker_codes("DICT_5X5_100"), 22.0 / 30.0
    image = image_of(target, blur_px=1.2)
    slope = np.linspace(0.5, 1.2, 640)
    image = np.clip(image * slope, 0, 255).astype(np.uint8)
    board = next(lattices_of(image, next(iter(levels(image))), charuco_layout(target)))
    rng = np.random.default_rng(4)
    y, x = np.mgrid[0:8, 0:11].astype(float)
    grid = np.stack([60 + 44 * x + 5 * y, 50 - 3 * x + 40 * y], axis=2)
    flat = np.zeros((8, 11))
    of_noise = Lattice(grid, flat, flat > 0, True)
    noise = cv2.GaussianBlur(rng.integers(0, 256, (480, 640)).astype(np.uint8), (0, 0), 9.0)
    noise = cv2.normalize(noise, None, 0, 255, cv2.NORM_MINMAX)
    compared = 0
    for view, lattice in ((image, board), (noise, of_noise)):
        readings = decode_markers(view, lattice, codes.side, size)
        places = readings.places_px
        read = {
            tuple(place): code for place, code in zip(readings.place.tolist(), readings.codes, strict=True)
        }
        turned = {tuple(p): code for p, code in zip(readings.place.tolist(), readings.mirrored, strict=True)}
        for j, i in itertools.product(range(places.shape[0] - 1), range(places.shape[1] - 1)):
            corners = places[[j, j, j + 1, j + 1], [i, i + 1, i + 1, i]]
            known = np.isfinite(np.pad(lattice.gap, 1, constant_values=np.nan)[j : j + 2, i : i + 2]).any()
            inside = (corners >= 1.0).all() and (corners <= [638.0, 478.0]).all()
            if ((i + j) % 2 == 0) != lattice.origin_is_bright or not known or not inside:
                assert (i - 1, j - 1) not in read
                continue
            bits = plain_reading(view, corners, codes, size)
            assert ((i - 1, j - 1) in read) == (bits is not None)
            if bits is not None:
                compared += 1
                assert code_of(bits[None])[0] == read[i - 1, j - 1]
                assert code_of(bits.T[None])[0] == turned[i - 1, j - 1]
    assert compared >= 15
