"""A session's camera and the target's shape as JSON."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.analyses.common import (
    EstimatedAnalysis,
    Matrix,
    TargetTransform,
    Vector,
)
from app.api.schemas.camera import (
    CalibrationGrade,
    FocalInterval,
    IntrinsicsRead,
    LensDistortionRead,
    LensModel,
    LensUncertainty,
)
from app.api.schemas.common import ResponseModel
from app.api.schemas.fields import FocusGroup, MeasurementId, TargetId
from app.api.schemas.image_maps import ProjectionUncertaintyRead, RadialResidualRead, ResidualMapRead

CameraFileFormat = TypeAliasType(
    "CameraFileFormat",
    Annotated[
        Literal["opencv", "ros", "kalibr", "mrcal"], Field(description="Whose camera file is written.")
    ],
)
_CHI = Field(
    description="Squared residuals over the grid points' stated uncertainties, per degree of freedom: about 1 where "
    "camera and print are as the model has them."
)


class ImageResidual(ResponseModel):
    """An image and the root mean square of its residual distances."""

    measurement_id: MeasurementId
    rms_px: Annotated[float, Field(description="Root mean square of the image's residual distances, px.")]


class GroupIntrinsics(ResponseModel):
    """The camera of one focus group; with the estimators that calibrate every image by itself, the mean over images."""

    focus_group: FocusGroup
    image_count: Annotated[int, Field(description="How many images it comes from.")]
    lens_model: Annotated[
        LensModel,
        Field(
            description="`brown`: OpenCV's five coefficients, k3 held at 0. `kannala_brandt`: the angular model of "
            "OpenCV's `fisheye`, with p1 and p2. `rational`: OpenCV's eight coefficients."
        ),
    ]
    intrinsics: Annotated[IntrinsicsRead, Field(description="Focal lengths and principal point, px.")]
    distortion: Annotated[
        LensDistortionRead, Field(description="The coefficients of `lens_model`, by name; dimensionless.")
    ]
    standard_uncertainty: Annotated[
        LensUncertainty, Field(description="Of intrinsics and distortion; 0 where they were given.")
    ]
    grade: Annotated[
        CalibrationGrade,
        Field(
            description="`determined`: the focal length is known to a standard uncertainty of 2 % or better. `weak`: "
            "to 14 % or better, with the warning `focal_weakly_observable`; figures of a robot may be refused."
        ),
    ]
    interval_95: Annotated[
        FocalInterval,
        Field(
            description="95 % intervals of the focal lengths; use them where `grade` is `weak`: they are asymmetric."
        ),
    ]
    reduced_chi2: Annotated[float, _CHI]


class HeldOutLens(ResponseModel):
    """Lens models on images that were held out of the fit, in five folds; only their poses were fitted."""

    rms_ratio: Annotated[
        float,
        Field(
            description="Residual rms with the model `kannala_brandt` over that with Brown's, geometric mean over "
            "images; another model is taken below .95.",
            examples=[0.76],
        ),
    ]


class LensEvidenceRead(ResponseModel):
    """What speaks against Brown's lens model (docs/method.md, lens models)."""

    statistic: Annotated[
        float,
        Field(
            description="w = N ln(χ²_Brown/χ²_KB) over N coordinates of grid points; noise alone exceeds 30 with a "
            "probability of 3e-7.",
            examples=[410.0],
        ),
    ]
    share: Annotated[
        float,
        Field(description="w/N; another model is considered from .03 on, with w above 30.", examples=[0.7]),
    ]
    held_out: Annotated[
        HeldOutLens | None,
        Field(
            description="How well images are explained that were held out of the fit; null where that was not needed, "
            "or with fewer than four poses."
        ),
    ]


class GroupCalibration(GroupIntrinsics):
    """The camera of one focus group, with its covariance and the images it explains worst."""

    covariance: Annotated[
        Matrix,
        Field(
            description="In the order fx, fy, cx, cy (px), then the coefficients of `lens_model`: k1, k2, p1, p2, k3 "
            "(`brown`, 9 x 9), k1, k2, k3, k4, p1, p2 (`kannala_brandt`, 10 x 10), or k1, k2, p1, p2, k3, k4, k5, k6 "
            "(`rational`, 12 x 12); 0 where held fixed."
        ),
    ]
    lens_evidence: Annotated[
        LensEvidenceRead | None,
        Field(
            description="What speaks against Brown's model; null with fewer than two poses, or without a common camera."
        ),
    ]
    observed_radius_px: Annotated[
        float,
        Field(
            description="How far from the principal point the outermost grid point lies, px: beyond it the lens model "
            "is an extrapolation."
        ),
    ]
    fold_radius_px: Annotated[
        float | None,
        Field(
            description="How far from the principal point the lens model turns back, px: beyond it pixels have no "
            "direction. Null where it does not."
        ),
    ]
    highest_residuals: Annotated[
        list[ImageResidual], Field(description="The images that it explains worst, the worst first.")
    ]
    residual_map: Annotated[
        ResidualMapRead,
        Field(
            description="Where mean residuals remain in more cells than chance gives, the lens model does not fit."
        ),
    ]
    radial_residuals: Annotated[
        list[RadialResidualRead],
        Field(
            description="By distance from the principal point, in 24 rings up to `observed_radius_px`, those with "
            "eight points or more: a pattern is a lens beyond its model."
        ),
    ]
    projection_uncertainty: Annotated[
        ProjectionUncertaintyRead,
        Field(
            description="How certain the camera is by place in the image, and which parts of it no grid point covers."
        ),
    ]


class ShapeUncertainty(ResponseModel):
    """Standard uncertainties of the shape's measures."""

    bow_x_mm: Annotated[float, Field(description="Of `bow_x_mm`, mm.")]
    bow_y_mm: Annotated[float, Field(description="Of `bow_y_mm`, mm.")]
    twist_mm: Annotated[float, Field(description="Of `twist_mm`, mm.")]
    aspect: Annotated[float, Field(description="Of `aspect`, dimensionless.")]
    shear_deg: Annotated[float, Field(description="Of `shear_deg`, degrees.")]


class ShapeDeformation(ResponseModel):
    """How far grid points are from their places, over all points."""

    rms_mm: Annotated[float, Field(description="Root mean square of the points' deviations, mm.")]
    standard_uncertainty_mm: Annotated[float, Field(description="Standard uncertainty of `rms_mm`, mm.")]
    noise_mm: Annotated[float, Field(description="The rms expected of the estimate's uncertainty alone, mm.")]
    largest_mm: Annotated[float, Field(description="Largest deviation of a point, mm.")]
    significant: Annotated[
        bool, Field(description="Whether noise alone would give so much once in a thousand times at most.")
    ]


class ShapePoint(ResponseModel):
    """One grid point's deviation from its place, in the target frame."""

    column: Annotated[int, Field(description="The grid point's column in the target, from 0 along x.")]
    row: Annotated[int, Field(description="The grid point's row in the target, from 0 along y.")]
    deviation_mm: Annotated[
        Vector, Field(description="x, y, z of the point less those of its nominal place, mm.")
    ]
    deviation_sigma_mm: Annotated[
        Vector, Field(description="Standard uncertainties of `deviation_mm` along x, y, z, mm.")
    ]


class TargetShape(ResponseModel):
    """The target as it is: deviations from the ideal grid after the best move, turn and scaling of the whole."""

    target_id: TargetId
    focus_group: Annotated[str, Field(description="Whose images it comes from.")]
    image_count: Annotated[int, Field(description="How many images it comes from.")]
    view_directions: Annotated[
        int,
        Field(description="From which the images show it that differ by 5° and are tilted by 10° or more."),
    ]
    used_for_calibration: Annotated[
        bool,
        Field(
            description="Whether the cameras are those before the refined target: where anything is significant."
        ),
    ]
    rms_before_px: Annotated[
        float,
        Field(description="Root mean square of the residual distances with the target taken as perfect, px."),
    ]
    rms_px: Annotated[float, Field(description="The same with the target's shape estimated, px.")]
    reduced_chi2: Annotated[float, _CHI]
    in_plane: Annotated[ShapeDeformation, Field(description="Deviations along x and y: errors of the print.")]
    out_of_plane: Annotated[ShapeDeformation, Field(description="Deviations along z: bow and twist.")]
    bow_x_mm: Annotated[
        float,
        Field(
            description="How far the middle of a row stands out along z (into the board) from its ends, mm."
        ),
    ]
    bow_y_mm: Annotated[
        float, Field(description="How far the middle of a column stands out along z from its ends, mm.")
    ]
    twist_mm: Annotated[
        float, Field(description="How far the corners stand out of the plane, two up and two down, mm.")
    ]
    aspect: Annotated[float, Field(description="Length along x over length along y, less 1.")]
    shear_deg: Annotated[float, Field(description="By how much less than 90° the axes meet, degrees.")]
    standard_uncertainty: Annotated[ShapeUncertainty, Field(description="Of bow, twist, aspect and shear.")]
    points: Annotated[list[ShapePoint], Field(description="Every grid point's deviation.")]


class IntrinsicsAnalysis(EstimatedAnalysis):
    """The camera of a session, focus group by focus group."""

    groups: Annotated[list[GroupCalibration], Field(description="The camera of each focus group.")]
    target_transforms: Annotated[
        list[TargetTransform],
        Field(description="How the session's targets lie to one another; empty where no images show two."),
    ]
    target_shape: Annotated[
        TargetShape | None, Field(description="The target's own shape; null without `refine_target`.")
    ]
