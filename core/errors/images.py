"""What is wrong with the caller's arguments, with an image's bytes, or with what the image shows."""

from __future__ import annotations

from core.errors.base import GridposeError


class InvalidInput(GridposeError):
    code = "invalid_input"
    default_advice = "Correct the value named and try again."


class InvalidTarget(InvalidInput):
    code = "invalid_target"

    def __init__(self, detail: str, advice: str | None = None, *, field: str | None = None) -> None:
        super().__init__(detail, advice)
        self.field = field
        """The field of `core.targets.TargetSpec` that is to be corrected, where it is one."""


class InvalidArgument(InvalidInput):
    code = "invalid_argument"


class ImageError(GridposeError):
    code = "image_error"


class EmptyImage(ImageError):
    code = "empty_upload"
    default_advice = "Send the image file's bytes as the body."


class UnsupportedImage(ImageError):
    code = "unsupported_image"
    default_advice = "Send PNG, JPEG, TIFF or BMP with 8 or 16 bit, grey or colour."


class ImageTooManyPixels(ImageError):
    code = "image_too_many_pixels"
    default_advice = (
        "Bin the image or scale it down, or raise GRIDPOSE_MAX_IMAGE_PIXELS. Do not crop it: the lens's middle would "
        "no longer be the image's."
    )


class UndecodableImage(ImageError):
    code = "undecodable_image"
    default_advice = "The file is damaged or cut short; save it again and upload that."


class DetectionError(GridposeError):
    code = "detection_error"


class TargetNotFound(DetectionError):
    code = "target_not_found"
    default_advice = "Show the whole grid, sharp and evenly lit, and check the target's size."


class TargetMismatch(DetectionError):
    code = "target_mismatch"
    default_advice = "Check columns and rows, which count inner corners; keep other grids out of view."


class TargetAmbiguous(DetectionError):
    code = "target_ambiguous"
    default_advice = "Name the target (target_id), or use targets that differ in size or dictionary."


class TargetMirrored(DetectionError):
    code = "target_mirrored"
    default_advice = "Print without mirroring, and switch the camera's image mirroring off."


class OriginUnknown(DetectionError):
    code = "labelling_ambiguous"
    default_advice = "Show the whole board, or use ChArUco, an AprilGrid, or a chessboard with dots."
