"""Indices of how well poses determine a robot, and stated uncertainties compared with sampling, as JSON."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.common import ResponseModel

DhUncertaintyMethod = TypeAliasType(
    "DhUncertaintyMethod",
    Annotated[
        Literal["analytic", "monte_carlo"],
        Field(description="By what the uncertainties of parameters are known."),
    ],
)


class ObservabilityIndicesRead(ResponseModel):
    """Indices of how well poses determine the parameters, from the singular values σ1 ≥ ... ≥ σL of the Jacobian of n
    poses, where 1 mm and an angle that moves the arm's end by 1 mm weigh the same. All are larger for better poses of
    one robot.
    """

    o1: Annotated[
        float,
        Field(
            description="(σ1 ... σL)^(1/L) / √n: the volume of the confidence ellipsoid (Borm and Menq); whatever the "
            "number of poses."
        ),
    ]
    o2: Annotated[
        float,
        Field(description="σL / σ1: its shape, the inverse of the condition number (Driels and Pathre)."),
    ]
    o3: Annotated[
        float,
        Field(
            description="σL: its longest axis, the worst determined combination (Nahvi, Hollerbach, Hayward)."
        ),
    ]
    o4: Annotated[
        float,
        Field(description="σL² / σ1: the worst amplification of unmodelled errors (Nahvi and Hollerbach)."),
    ]
    o5: Annotated[
        float,
        Field(description="1 / (1/σ1 + ... + 1/σL): the sum of its axes (Sun and Hollerbach)."),
    ]


class SampledParameter(ResponseModel):
    """One parameter by sampling."""

    parameter: Annotated[str, Field(description="Its key, as in `parameters`.")]
    uncertainty_ratio: Annotated[
        float, Field(description="Standard deviation of the trials over the stated standard uncertainty.")
    ]
    mean_shift: Annotated[
        float, Field(description="Mean of the trials less the parameter, in stated standard uncertainties.")
    ]
    agrees: Annotated[bool, Field(description="Whether both lie within the tolerances.")]


class ParameterSamplingRead(ResponseModel):
    """Stated uncertainties compared with sampling: poses drawn about the identified arm, each draw identified anew."""

    trials: Annotated[int, Field(description="Draws of all poses.")]
    joint_ratio: Annotated[
        float,
        Field(
            description="Root mean square Mahalanobis distance of the trials by the stated covariance, over that of "
            "normal errors; 1 where covariance and trials are the same."
        ),
    ]
    ratio_tolerance: Annotated[
        float, Field(description="How far a ratio may be from 1: 5 %, and what so many trials leave open.")
    ]
    shift_tolerance: Annotated[
        float, Field(description="How far a shift may be from 0: the same, of a mean.")
    ]
    agrees: Annotated[bool, Field(description="Whether all parameters agree.")]
    sampled_parameters: Annotated[
        list[SampledParameter], Field(description="Every fitted parameter, in the order of `parameters`.")
    ]
