"""Results of the methods of the comparison, image by image: answers and failures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from core.calibration import Reprojection, reprojection
from core.errors import Advisory, DegenerateGeometry, GridposeError, NotConverged
from core.geometry import Camera

MAX_DISTANCE_MM = 1e6
"""A kilometre: a target that a method puts farther away was not found there."""
CameraOf = Literal["each_image", "all_images", "given"]


@dataclass(frozen=True, slots=True)
class MethodResult:
    """The answer of one method, for the views it was given, in their order.

    `camera` is None, and `T_camera_target` empty, where the method maps points without a camera model. `residuals_px`
    are observed - predicted by the method's own mapping, one array a view: none of these methods rejects points.
    """

    method: str
    camera: Camera | None
    T_camera_target: tuple[Float[np.ndarray, "4 4"], ...]
    residuals_px: tuple[Float[np.ndarray, "_ 2"], ...]
    warnings: tuple[Advisory, ...] = ()


@dataclass(frozen=True, slots=True)
class Answer:
    """Result of a method for these images, in the order of its poses."""

    images: tuple[int, ...]
    result: MethodResult


@dataclass(frozen=True, slots=True)
class Failure:
    """Failure on one image, by its index; None for the images together."""

    image: int | None
    code: str
    detail: str
    advice: str | None


@dataclass(frozen=True, slots=True)
class CameraFigures:
    """Cameras in the order of `CAMERA_PARAMETERS`: the mean over `images` of them and, of two or more, the standard
    deviation (n - 1). One camera for all images has no deviation.
    """

    images: int
    mean: Float[np.ndarray, "9"]
    spread: Float[np.ndarray, "9"] | None


@dataclass(frozen=True, slots=True)
class MethodRow:
    """One method over all images.

    `camera_of` states whose camera it is: each image's own, one calibrated from all images together, or a given one.
    `scatter` is the method's covariance of its poses among images of one pose (x, y, z in mm, then a small rotation, in
    the target frame), by image; None where the method gives none.
    """

    method: str
    camera_of: CameraOf
    answers: tuple[Answer, ...]
    failures: tuple[Failure, ...]
    warnings: tuple[Advisory, ...] = ()
    scatter: Mapping[int, Float[np.ndarray, "6 6"]] | None = None

    @property
    def images(self) -> tuple[int, ...]:
        """The images answered for, ascending."""
        return tuple(sorted(image for answer in self.answers for image in answer.images))

    @property
    def poses(self) -> dict[int, Float[np.ndarray, "4 4"]]:
        """T_camera_target by image."""
        return {
            image: T
            for answer in self.answers
            for image, T in zip(answer.images, answer.result.T_camera_target, strict=True)
        }

    @property
    def failure(self) -> Failure | None:
        """The failure if there is no answer at all, or None."""
        if self.answers:
            return None
        together = [failure for failure in self.failures if failure.image is None]
        return next(iter((*together, *self.failures)), None)

    @property
    def reprojection(self) -> Reprojection | None:
        """Statistics of all points of the images answered for; None where there are fewer than two points."""
        residuals = [r for answer in self.answers for r in answer.result.residuals_px]
        together = np.concatenate(residuals) if residuals else np.zeros((0, 2))
        return reprojection(together, np.ones(len(together), dtype=np.bool_)) if len(together) > 1 else None

    @property
    def camera(self) -> CameraFigures | None:
        """Statistics of the estimated cameras; None without any."""
        cameras = [a.result.camera.as_array() for a in self.answers if a.result.camera is not None]
        if not cameras:
            return None
        if self.camera_of != "each_image":
            return CameraFigures(len(self.images), cameras[0], None)
        spread = np.std(cameras, axis=0, ddof=1) if len(cameras) > 1 else None
        return CameraFigures(len(cameras), np.mean(cameras, axis=0), spread)


def attempt(image: int | None, answer: Callable[[], Answer]) -> Answer | Failure:
    """Return the answer, or the failure for this image (None: for the images together).

    An answer without a camera is a failure, for the reason it states: it determines no pose.
    """
    reason: Advisory | GridposeError
    try:
        found = answer()
        _require_sense(found.result)
    except GridposeError as error:
        reason = error
    except (np.linalg.LinAlgError, ArithmeticError):
        reason = DegenerateGeometry("The grid points found do not determine the camera and its pose.")
    else:
        if found.result.camera is not None:
            return found
        reason = found.result.warnings[0]
    return Failure(image, reason.code, reason.detail, reason.advice)


def _require_sense(answer: MethodResult) -> None:
    """Raise NotConverged unless every number is finite, and every target where a camera could see it."""
    numbers = [*answer.T_camera_target, *answer.residuals_px]
    if answer.camera is not None:
        numbers.append(answer.camera.as_array())
    if not all(np.all(np.isfinite(n)) for n in numbers):
        raise NotConverged("The method returned no finite answer.")
    farthest = max((float(np.abs(T[:3, 3]).max()) for T in answer.T_camera_target), default=0.0)
    if farthest > MAX_DISTANCE_MM:
        raise NotConverged(f"The method puts the target {farthest / 1e6:.3g} km from the camera.")
