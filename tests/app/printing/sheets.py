"""Sheets as printers see them: rasterised by programs that nobody here wrote."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pypdfium2
import resvg_py

from app.printing import Sheet, to_pdf, to_svg
from core import TargetSpec

MM_PER_INCH = 25.4
FINER = 4


@dataclass(frozen=True)
class Case:
    """A target, and what is drawn next to it."""

    target: TargetSpec
    origin_dot: float = 1.0
    marks: bool = False
    paper: str = "A4"
    labelling: str = "absolute"

    def __str__(self) -> str:
        extra = (
            "-marks" * self.marks + "-dot" * (self.origin_dot != 1.0) + "-legacy" * self.target.legacy_layout
        )
        return f"{self.target.kind}-{self.target.columns}x{self.target.rows}{extra}-{self.paper}"


CASES = [
    Case(TargetSpec("chessboard", 9, 6, 25.0)),
    Case(TargetSpec("chessboard", 8, 6, 20.0), marks=True),
    Case(TargetSpec("chessboard", 10, 8, 10.0), labelling="up_to_symmetry"),
    Case(TargetSpec("charuco", 5, 8, 28.0, 20.0, "DICT_6X6_250")),
    Case(TargetSpec("charuco", 4, 7, 30.0, 15.0, "DICT_4X4_50", legacy_layout=True)),
    Case(TargetSpec("circles", 10, 7, 20.0), origin_dot=1.5),
    Case(TargetSpec("asymmetric_circles", 4, 11, 17.0)),
    Case(TargetSpec("aprilgrid", 6, 4, 40.0, 30.0)),
    Case(TargetSpec("charuco", 17, 11, 60.0, 45.0, "DICT_5X5_1000"), paper="A0"),
]


@dataclass(frozen=True)
class Raster:
    """Grey values of a whole sheet, how large a pixel is (across, down), and how far (px) edges may be off."""

    levels: np.ndarray
    mm_per_px: np.ndarray
    rounding_px: float

    def on_paper(self, points_px: np.ndarray) -> np.ndarray:
        """Return where pixels lie, mm from the sheet's upper left corner."""
        return (points_px + 0.5) * self.mm_per_px

    @property
    def as_scanned(self) -> np.ndarray:
        """The same through a lens and with noise: no camera shows edges as sharp and as clean as a rasteriser does."""
        blurred = cv2.GaussianBlur(self.levels.astype(np.float64), (0, 0), 1.0)
        noise = np.random.default_rng(0).normal(0.0, 2.0, blurred.shape)
        return np.clip(np.rint(20.0 + 0.8 * blurred + noise), 0, 255).astype(np.uint8)


def pdf_raster(sheet: Sheet, dpi: float) -> Raster:
    page = pypdfium2.PdfDocument(to_pdf(sheet))[0]
    levels = np.ascontiguousarray(page.render(scale=dpi / 72.0, grayscale=True).to_numpy().squeeze())
    paper = np.array([sheet.paper.width_mm, sheet.paper.height_mm])
    # pdfium stretches the page to whole pixels, and distinguishes 256 grey levels at an edge.
    return Raster(levels, paper / levels.shape[::-1], 0.03)


def svg_raster(sheet: Sheet, dpi: float) -> Raster:
    # resvg resolves places to a quarter of a pixel: made larger, and averaged.
    png = resvg_py.svg_to_bytes(svg_string=to_svg(sheet).decode(), dpi=FINER * dpi)
    levels = cv2.imdecode(np.frombuffer(bytes(png), np.uint8), cv2.IMREAD_GRAYSCALE)
    height, width = (size // FINER for size in levels.shape)
    levels = levels[: height * FINER, : width * FINER]
    levels = cv2.resize(levels, (width, height), interpolation=cv2.INTER_AREA)
    return Raster(levels, np.full(2, MM_PER_INCH / dpi), 0.25 / FINER)
