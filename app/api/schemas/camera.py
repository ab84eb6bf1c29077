"""A camera's parameters and the calibration of one image as JSON."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.common import AdvisoryRead, RequestModel, ResponseModel
from app.api.schemas.fields import Estimator, Pitch, PoseCovariance, Roll, RotationMatrix, Yaw

FocalLength = Annotated[float, Field(gt=0, le=1e7)]
PixelCoordinate = Annotated[float, Field(ge=-1e6, le=1e6)]
DistortionCoefficient = Annotated[float, Field(ge=-1e6, le=1e6)]
CalibrationGrade = TypeAliasType(
    "CalibrationGrade",
    Annotated[
        Literal["determined", "weak"],
        Field(description="Whether the focal length is determined to 2 %, or less well."),
    ],
)
FitStart = TypeAliasType(
    "FitStart",
    Annotated[
        Literal["nullspace", "vanishing_point", "nominal"], Field(description="What a fit began with.")
    ],
)
LensModel = TypeAliasType(
    "LensModel",
    Annotated[
        Literal["brown", "kannala_brandt", "rational"],
        Field(
            description="How a lens distorts: Brown's polynomial in the tangent of the angle from the axis, Kannala's "
            "and Brandt's in the angle itself, or a ratio of polynomials in the tangent."
        ),
    ],
)

_FX = "Focal length along u (the image's columns), px."
_FY = "Focal length along v (the image's rows), px."
_CX = "Principal point, u coordinate, px; 0 is the centre of the leftmost pixel."
_CY = "Principal point, v coordinate, px; 0 is the centre of the topmost pixel, v points down."
_K1 = "Radial distortion, coefficient of r² in OpenCV's model; r is dimensionless, in the plane z = 1."
_K2 = "Radial distortion, coefficient of r⁴ in OpenCV's model."
_P1 = "Tangential distortion, OpenCV's first coefficient."
_P2 = "Tangential distortion, OpenCV's second coefficient."
_K3 = "Radial distortion, coefficient of r⁶ in OpenCV's model."


class StatedCamera(RequestModel):
    """A camera that the user states."""

    fx_px: Annotated[FocalLength, Field(description=_FX)]
    fy_px: Annotated[FocalLength, Field(description=_FY)]
    cx_px: Annotated[PixelCoordinate, Field(description=_CX)]
    cy_px: Annotated[PixelCoordinate, Field(description=_CY)]
    k1: Annotated[DistortionCoefficient, Field(description=_K1)] = 0.0
    k2: Annotated[DistortionCoefficient, Field(description=_K2)] = 0.0
    p1: Annotated[DistortionCoefficient, Field(description=_P1)] = 0.0
    p2: Annotated[DistortionCoefficient, Field(description=_P2)] = 0.0
    k3: Annotated[DistortionCoefficient, Field(description=_K3)] = 0.0


class IntrinsicsRead(ResponseModel):
    """Focal lengths and principal point: u = fx x + cx, v = fy y + cy of the distorted point (x, y) at z = 1."""

    fx_px: Annotated[float, Field(description=_FX)]
    fy_px: Annotated[float, Field(description=_FY)]
    cx_px: Annotated[float, Field(description=_CX)]
    cy_px: Annotated[float, Field(description=_CY)]


class DistortionRead(ResponseModel):
    """The lens's distortion by OpenCV's model of five coefficients, in its order; dimensionless."""

    k1: Annotated[float, Field(description=_K1)]
    k2: Annotated[float, Field(description=_K2)]
    p1: Annotated[float, Field(description=_P1)]
    p2: Annotated[float, Field(description=_P2)]
    k3: Annotated[float, Field(description=_K3)]


class CameraUncertainty(ResponseModel):
    """Standard uncertainties (one standard deviation); 0 where the parameter was given."""

    fx_px: Annotated[float, Field(description="Standard uncertainty of `fx_px`, px.")]
    fy_px: Annotated[float, Field(description="Standard uncertainty of `fy_px`, px.")]
    cx_px: Annotated[float, Field(description="Standard uncertainty of `cx_px`, px.")]
    cy_px: Annotated[float, Field(description="Standard uncertainty of `cy_px`, px.")]
    k1: Annotated[float, Field(description="Standard uncertainty of `k1`, dimensionless.")]
    k2: Annotated[float, Field(description="Standard uncertainty of `k2`, dimensionless.")]
    p1: Annotated[float, Field(description="Standard uncertainty of `p1`, dimensionless.")]
    p2: Annotated[float, Field(description="Standard uncertainty of `p2`, dimensionless.")]
    k3: Annotated[float, Field(description="Standard uncertainty of `k3`, dimensionless.")]


class LensDistortionRead(DistortionRead):
    """The lens's distortion by the coefficients of its model, dimensionless.

    Brown's model, that of every single image, has k1, k2, p1, p2 and k3. In the others k1, k2 and k3 are the
    coefficients of that model (docs/method.md, lens models), and k4 to k6 are present as far as it has them.
    """

    k4: Annotated[
        float | None,
        Field(
            description="Of `kannala_brandt`, coefficient of θ⁹; of `rational`, of r² below the fraction; absent in "
            "`brown`."
        ),
    ] = None
    k5: Annotated[
        float | None,
        Field(description="Of `rational`, coefficient of r⁴ below the fraction; absent in other models."),
    ] = None
    k6: Annotated[
        float | None,
        Field(description="Of `rational`, coefficient of r⁶ below the fraction; absent in other models."),
    ] = None


class LensUncertainty(CameraUncertainty):
    """Standard uncertainties of a camera by its lens model; 0 where the parameter was given or held."""

    k4: Annotated[
        float | None, Field(description="Standard uncertainty of `k4`, dimensionless; absent where `k4` is.")
    ] = None
    k5: Annotated[
        float | None, Field(description="Standard uncertainty of `k5`, dimensionless; absent where `k5` is.")
    ] = None
    k6: Annotated[
        float | None, Field(description="Standard uncertainty of `k6`, dimensionless; absent where `k6` is.")
    ] = None


class PoseUncertainty(ResponseModel):
    """Standard uncertainties (one standard deviation) of position and angles."""

    x_mm: Annotated[float, Field(description="Of the position along x, mm.")]
    y_mm: Annotated[float, Field(description="Of the position along y, mm.")]
    z_mm: Annotated[float, Field(description="Of the position along z, mm.")]
    roll_deg: Annotated[float, Field(description="Of the roll angle, degrees.")]
    pitch_deg: Annotated[float, Field(description="Of the pitch angle, degrees.")]
    yaw_deg: Annotated[float, Field(description="Of the yaw angle, degrees.")]


class CameraPoseRead(ResponseModel):
    """The camera in the target frame; covariances in mm and rad."""

    position_mm: Annotated[
        list[float],
        Field(
            min_length=3,
            max_length=3,
            description="The camera's centre x, y, z in the target frame, mm: -Rᵀt with R, t of `T_camera_target`.",
        ),
    ]
    rotation: RotationMatrix
    roll_deg: Roll
    pitch_deg: Pitch
    yaw_deg: Yaw
    standard_uncertainty: Annotated[
        PoseUncertainty, Field(description="Of position and angles, the camera's own uncertainty included.")
    ]
    covariance: PoseCovariance
    covariance_given_camera: Annotated[
        list[list[float]],
        Field(
            description="As `covariance`, but for a camera that is known exactly: what differs between images of one "
            "camera."
        ),
    ]


class ReprojectionRead(ResponseModel):
    """Residual distances, observed to predicted image point, over the grid points that the fit used."""

    rms_px: Annotated[float, Field(description="Root mean square of the distances, px.")]
    mean_px: Annotated[float, Field(description="Mean of the distances, px.")]
    std_px: Annotated[float, Field(description="Standard deviation of the distances, px.")]
    max_px: Annotated[float, Field(description="Largest of the distances, px.")]
    points: Annotated[int, Field(description="How many grid points the fit used.")]
    rejected: Annotated[int, Field(description="How many grid points were found, but rejected by the fit.")]


class ObservabilityRead(ResponseModel):
    """How well the view determines the camera."""

    focal_relative_uncertainty: Annotated[
        float,
        Field(
            description="Standard uncertainty of the focal length over its value; `grade` follows from it."
        ),
    ]
    condition_number: Annotated[
        float,
        Field(
            description="Of the scaled normal matrix, 1 or more: the larger, the less accurately some combination of "
            "parameters is determined."
        ),
    ]
    tilt_deg: Annotated[
        float,
        Field(
            description="Angle between the optical axis and the target's normal, degrees; near 0 the focal length and "
            "the distance cannot be separated."
        ),
    ]
    prior_dominated: Annotated[
        list[str],
        Field(
            description="Names of the parameters whose uncertainty is mostly that of the prior; empty where none is."
        ),
    ]
    ambiguity_log_likelihood_ratio: float | None = Field(
        default=None,
        description="Log-likelihood of the pose less that of the second pose, whose tilt is mirrored about the line of "
        "sight: near 0 the image does not distinguish the two. Null without a second minimum.",
    )


class FocalInterval(ResponseModel):
    """95 % intervals [low, high] of the focal lengths, longer above than below; of no length where they were given."""

    fx_px: list[float] = Field(min_length=2, max_length=2, description="[low, high] of `fx_px`, px.")
    fy_px: list[float] = Field(min_length=2, max_length=2, description="[low, high] of `fy_px`, px.")


class CalibrationRead(ResponseModel):
    """One image, calibrated."""

    estimator: Annotated[
        Estimator,
        Field(
            description="`per_image`: camera and pose from this image. `given`: the pose with the session's intrinsics."
        ),
    ]
    initialisation: Annotated[
        FitStart,
        Field(
            description="What the fit began with: `nullspace`, `vanishing_point` or `nominal` (a stated or usual "
            "focal length)."
        ),
    ]
    grade: CalibrationGrade = Field(
        description="`determined`: the image by itself determines the focal length to a standard uncertainty of 2 % or "
        "better. `weak`: to 14 % or better, with the warning `focal_weakly_observable`; the session's camera is better."
    )
    image_width_px: Annotated[int, Field(description="Columns of the image, px.")]
    image_height_px: Annotated[int, Field(description="Rows of the image, px.")]
    intrinsics: Annotated[IntrinsicsRead, Field(description="Focal lengths and principal point, px.")]
    distortion: Annotated[DistortionRead, Field(description="OpenCV's five coefficients, dimensionless.")]
    standard_uncertainty: Annotated[
        CameraUncertainty, Field(description="Of intrinsics and distortion; 0 where they were given.")
    ]
    interval_95: Annotated[
        FocalInterval,
        Field(
            description="95 % intervals of the focal lengths; use them where `grade` is `weak`: they are asymmetric."
        ),
    ]
    T_camera_target: Annotated[
        list[list[float]],
        Field(
            description="4 x 4, mm: maps points of the target into the camera frame (x right, y down, z forward)."
        ),
    ]
    pose: Annotated[
        CameraPoseRead, Field(description="The camera in the target frame, the inverse of `T_camera_target`.")
    ]
    reprojection: Annotated[
        ReprojectionRead, Field(description="Residual distances of the grid points used, px.")
    ]
    observability: Annotated[ObservabilityRead, Field(description="What the view determines, and how well.")]
    warnings: Annotated[
        list[AdvisoryRead],
        Field(description="What to know of this calibration; empty where there is nothing."),
    ]
