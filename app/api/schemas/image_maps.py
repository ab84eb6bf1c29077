"""What is known by place in the image: residuals, projection uncertainty, and coverage by grid points."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from app.api.schemas.common import ResponseModel, Share


class MeanResidualRead(ResponseModel):
    """What is left in one square cell of the image."""

    u_px: Annotated[float, Field(description="Middle of the cell, to the right, px.", examples=[79.5])]
    v_px: Annotated[float, Field(description="Middle of the cell, downwards, px.", examples=[79.5])]
    point_count: Annotated[int, Field(description="Grid points in it that count.", examples=[24])]
    residual_u_px: Annotated[
        float, Field(description="Mean residual (observed minus predicted) along u, px.", examples=[0.03])
    ]
    residual_v_px: Annotated[float, Field(description="The same along v, px.", examples=[-0.02])]
    rms_px: Annotated[
        float, Field(description="Root mean square of the residual distances in it, px.", examples=[0.2])
    ]
    beyond_chance: Annotated[
        bool,
        Field(
            description="Whether chance explains the mean in one cell of a hundred at most.", examples=[False]
        ),
    ]


class RadialResidualRead(ResponseModel):
    """What is left in a ring about the principal point: away from it positive."""

    radius_px: Annotated[float, Field(description="Middle of the ring, px.", examples=[210.0])]
    point_count: Annotated[int, Field(description="Grid points in it.", examples=[60])]
    mean_px: Annotated[
        float, Field(description="Mean of the residuals' parts along the radius, px.", examples=[0.01])
    ]
    standard_uncertainty_px: Annotated[
        float, Field(description="Its standard uncertainty by their scatter, px.", examples=[0.02])
    ]


class ResidualMapRead(ResponseModel):
    """The figures of `intrinsics/residuals.svg`: residuals by square cells of the image."""

    point_count: Annotated[int, Field(description="Grid points that count.", examples=[702])]
    outlier_count: Annotated[
        int,
        Field(
            description="Points beyond six times the median residual distance, which do not count.",
            examples=[0],
        ),
    ]
    rms_px: Annotated[
        float,
        Field(description="Root mean square of the residual distances of these points, px.", examples=[0.18]),
    ]
    cells: Annotated[int, Field(description="Cells with three points or more.", examples=[28])]
    cells_beyond_chance: Annotated[
        int,
        Field(
            description="Those whose mean residual chance explains in one cell of a hundred at most.",
            examples=[3],
        ),
    ]
    cells_by_chance: Annotated[
        float, Field(description="How many such cells chance alone would give.", examples=[0.28])
    ]
    mean_rms_px: Annotated[
        float, Field(description="Root mean square of the cells' mean residuals, px.", examples=[0.04])
    ]
    mean_residuals: Annotated[
        list[MeanResidualRead],
        Field(description="The cells with three points or more, row by row from the top."),
    ]


class ImageAreaRead(ResponseModel):
    """A third of the image by a third: how well points cover it, and how certain the camera is there."""

    name: Annotated[str, Field(description="Which of the nine.", examples=["upper left corner"])]
    point_count: Annotated[int, Field(description="Grid points in it.", examples=[120])]
    blank_share: Annotated[Share, Field(description="Share of its cells without any point.", examples=[0.2])]
    standard_uncertainty_px: Annotated[
        float | None,
        Field(
            description="Largest standard uncertainty of a projected point in it, px; null where the lens model has no "
            "direction.",
            examples=[0.031],
        ),
    ]


class ProjectionUncertaintyRead(ResponseModel):
    """The figures of `intrinsics/projection-uncertainty.svg`: of a projected point at infinity, by cells of the image.

    From the camera's covariance, along the direction in which it is largest. What a rotation of the camera takes up
    over the observed points is compensated: whoever uses the camera estimates its pose with the same lens.
    """

    cell_size_px: Annotated[float, Field(description="Side of the square cells, px.", examples=[160.0])]
    covered_share: Annotated[
        Share, Field(description="Share of the cells that have points.", examples=[0.93])
    ]
    largest_covered_px: Annotated[
        float | None,
        Field(description="Largest standard uncertainty of cells with points, px.", examples=[0.03]),
    ]
    largest_blank_px: Annotated[
        float | None,
        Field(
            description="Largest standard uncertainty of cells without points, px, where the lens model extrapolates; "
            "null where every cell has points.",
            examples=[0.2],
        ),
    ]
    blank_areas: Annotated[
        list[str],
        Field(
            description="Areas of which half of the cells or more have no point.",
            examples=[["upper left corner", "upper edge"]],
        ),
    ]
    areas: Annotated[
        list[ImageAreaRead],
        Field(description="The image's nine areas, row by row from the top."),
    ]
    cell_point_counts: Annotated[
        list[list[int]], Field(description="Grid points of every cell, row by row from the top.")
    ]
    cell_standard_uncertainties_px: Annotated[
        list[list[float | None]],
        Field(
            description="Standard uncertainty at the middle of every cell, px; null where the lens model has no "
            "direction, 0 where the intrinsics were given."
        ),
    ]
