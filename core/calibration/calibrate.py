"""The public door: bytes of one image in, its calibration out."""

from __future__ import annotations

from core.calibration.model import Lens
from core.calibration.result import Calibration
from core.calibration.single_image import calibrate_points
from core.camera import Camera
from core.image import DEFAULT_MAX_PIXELS, decode
from core.targets.detect import detect
from core.targets.specification import TargetSpec


def calibrate_image(
    data: bytes,
    target: TargetSpec,
    *,
    lens: Lens | None = None,
    intrinsics: Camera | None = None,
    max_pixels: int = DEFAULT_MAX_PIXELS,
) -> Calibration:
    """Decode one image, find the target in it, and calibrate camera and pose from it.

    `data` is a whole PNG, JPEG, TIFF or BMP file. EXIF orientation is ignored: pixels are the sensor's.

    Raises the leaves of ImageError, DetectionError and EstimationError (`core.errors`); those raised after
    grid points were found carry them as `.points`.
    """
    points = detect(decode(data, max_pixels=max_pixels), target)
    return calibrate_points(points, lens=lens, intrinsics=intrinsics)
