"""The position error of a robot's nominal kinematics over its workspace, as JSON."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from app.api.schemas.analyses.common import EstimatedAnalysis, SourceField, Vector
from app.api.schemas.common import ResponseModel
from app.api.schemas.fields import JOINT_ANGLES


class LargestError(ResponseModel):
    """Where the position error is largest between the joint angles of the measured poses."""

    joint_angles_deg: Annotated[list[float], Field(description=JOINT_ANGLES)]
    position_mm: Annotated[Vector, Field(description="The measured point in the robot's base frame, mm.")]
    error_mm: Annotated[
        float, Field(description="Distance of where it is from where the nominal robot is, mm.")
    ]
    standard_uncertainty_mm: Annotated[float, Field(description="Standard uncertainty of the distance, mm.")]
    error_vector_mm: Annotated[
        Vector,
        Field(
            description="Identified minus nominal position, mm, in the robot's base frame, as `position_mm` is."
        ),
    ]


class ErrorCellRead(ResponseModel):
    """One cell: the position error of the configurations that bring the measured point there."""

    radius_mm: Annotated[float, Field(description="Distance of its middle from the first axis, mm.")]
    height_mm: Annotated[float, Field(description="Height of its middle along the first axis, mm.")]
    configurations: Annotated[int, Field(description="Configurations that the figures are of.")]
    measured_configurations: Annotated[int, Field(description="Of these, those that were measured.")]
    extrapolated: Annotated[
        bool,
        Field(
            description="Whether no configuration between the joint angles of the measured poses reaches it; if so, "
            "the figures are of others, and extrapolated."
        ),
    ]
    median_error_mm: Annotated[float, Field(description="Median position error, mm.")]
    largest_error_mm: Annotated[float, Field(description="Largest position error, mm.")]
    median_uncertainty_mm: Annotated[float, Field(description="Median of its standard uncertainty, mm.")]


class ErrorMapRead(ResponseModel):
    """Position error over the workspace, by distance from the first axis and height; all around it."""

    cell_mm: Annotated[float, Field(description="Width and height of a cell, mm.")]
    samples: Annotated[int, Field(description="Configurations sampled, in addition to those measured.")]
    error_cells: Annotated[
        list[ErrorCellRead],
        Field(description="Cells that three or more configurations reach, or a measured one."),
    ]


class KinematicErrorAnalysis(EstimatedAnalysis):
    """How far the robot is from where its nominal parameters put it, over the workspace.

    Nominal base and tool are those that suit the measured poses best: an error that another base or tool removes does
    not count.
    """

    source: SourceField
    measured_configurations: Annotated[
        int, Field(description="Configurations that the robot was identified at.")
    ]
    median_error_mm: Annotated[
        float, Field(description="Median position error between the joint angles of the measured poses, mm.")
    ]
    median_uncertainty_mm: Annotated[float, Field(description="Median of its standard uncertainty, mm.")]
    largest_error_place: Annotated[LargestError, Field(description="Where the error is largest.")]
    error_map: Annotated[ErrorMapRead, Field(description="The error over the workspace.")]
    limits_stated: Annotated[
        list[bool],
        Field(
            description="Of each joint: whether the workspace ends at the robot's limits; if not, where the poses were."
        ),
    ]
