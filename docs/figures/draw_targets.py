"""Draw the figures of docs/targets.md: `python docs/figures/draw_targets.py [--into docs/figures]`.

Each is the very SVG that `gridpose targets print --format svg` writes, rasterised; what is shown is what is printed.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
import resvg_py

from app.printing import Sheet, draw_sheet, to_svg
from core import TargetSpec

DPI = 254.0
SHOWN_PX = 640


def sheets() -> dict[str, Sheet]:
    """Return one sheet of each kind, by the name of its figure."""
    return {
        "target-chessboard": draw_sheet(TargetSpec("chessboard", 9, 6, 25.0)),
        "target-chessboard-marks": draw_sheet(TargetSpec("chessboard", 10, 6, 22.0), marks=True),
        "target-charuco": draw_sheet(TargetSpec("charuco", 9, 6, 25.0, 18.0, "DICT_5X5_100")),
        "target-aprilgrid": draw_sheet(TargetSpec("aprilgrid", 6, 4, 40.0, 30.0)),
        "target-circles": draw_sheet(TargetSpec("circles", 10, 7, 23.0), origin_dot=1.5),
        "target-asymmetric-circles": draw_sheet(TargetSpec("asymmetric_circles", 6, 9, 18.0)),
    }


def rasterised(sheet: Sheet) -> np.ndarray:
    """Return the sheet as it looks, on the grey of a table, `SHOWN_PX` wide."""
    png = resvg_py.svg_to_bytes(svg_string=to_svg(sheet).decode(), dpi=DPI)
    levels = cv2.imdecode(np.frombuffer(bytes(png), np.uint8), cv2.IMREAD_GRAYSCALE)
    size = (SHOWN_PX, round(SHOWN_PX * levels.shape[0] / levels.shape[1]))
    return cv2.copyMakeBorder(
        cv2.resize(levels, size, interpolation=cv2.INTER_AREA), 8, 8, 8, 8, cv2.BORDER_CONSTANT, value=150
    )


def draw_all(into: Path) -> list[Path]:
    """Write the figures and return their paths."""
    into.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, sheet in sheets().items():
        path = into / f"{name}.png"
        encoded = cv2.imencode(".png", rasterised(sheet), [cv2.IMWRITE_PNG_COMPRESSION, 9])[1]
        path.write_bytes(encoded.tobytes())
        paths.append(path)
    return paths


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--into", type=Path, default=Path(__file__).parent)
    for written in draw_all(parser.parse_args().into):
        print(written)
