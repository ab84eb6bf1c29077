"""Uncertainty budgets (GUM) of headline figures as JSON."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.analyses.common import Interval
from app.api.schemas.common import ResponseModel

BudgetMethod = TypeAliasType(
    "BudgetMethod",
    Annotated[
        Literal["gum", "monte_carlo"],
        Field(
            description="`gum`: by the law of propagation of uncertainty; `monte_carlo`: by sampling the inputs, too."
        ),
    ],
)
BudgetFigure = TypeAliasType(
    "BudgetFigure",
    Annotated[
        Literal[
            "repeatability.rp_l_mm",
            "corrected.rp_l_mm",
            "noise_floor.rp_l_mm",
            "accuracy.ap_p_mm",
            "distances.ad_mm",
        ],
        Field(description="The figure, by its place in `poses` or in this analysis."),
    ],
)
BudgetSource = TypeAliasType(
    "BudgetSource",
    Annotated[
        Literal[
            "cycles",
            "noise_size",
            "noise_form",
            "frame_tie",
            "mean_of_visits",
            "lens",
            "print_scale",
            "print_shape",
        ],
        Field(
            description="`cycles`: their number is finite; `noise_size`, `noise_form`: of the images' noise; "
            "`frame_tie`: of robot and target, by the poses; `mean_of_visits`: scatter of the visits; `lens`: camera "
            "and sensor; `print_scale`, `print_shape`: of the target."
        ),
    ],
)


BudgetEvaluation = TypeAliasType(
    "BudgetEvaluation",
    Annotated[
        Literal["A", "B"],
        Field(description="How it is evaluated: `A` from a series of observations, `B` otherwise."),
    ],
)
BudgetDistribution = TypeAliasType(
    "BudgetDistribution",
    Annotated[
        Literal["normal", "student_t", "long_run_scatter"],
        Field(
            description="What is assigned to an input; `long_run_scatter`: of a long-run scatter, given a finite one."
        ),
    ],
)
BudgetUnit = TypeAliasType(
    "BudgetUnit",
    Annotated[Literal["mm", "1"], Field(description="`mm`, or `1` where the input is relative.")],
)


class _OfFigure(ResponseModel):
    figure: Annotated[BudgetFigure, Field(description="The figure, by its place in this analysis.")]
    pose_id: Annotated[str, Field(description="The pose, or where the distance begins, by the user's tag.")]
    to_pose_id: Annotated[
        str | None, Field(description="Where the distance ends; null: the figure is of one pose.")
    ]


class BudgetInput(_OfFigure):
    """One input of one figure."""

    source: Annotated[BudgetSource, Field(description="Where the uncertainty comes from.")]
    type: Annotated[BudgetEvaluation, Field(description="Evaluation by the GUM, 3.3.4.")]
    distribution: Annotated[BudgetDistribution, Field(description="What is assigned to the input.")]
    input_uncertainty: Annotated[
        float, Field(description="Standard uncertainty of the input, in `input_unit`.")
    ]
    input_unit: Annotated[BudgetUnit, Field(description="Unit of `input_uncertainty`.")]
    sensitivity: Annotated[
        float, Field(description="By how much the figure changes with the input, mm per `input_unit`.")
    ]
    standard_uncertainty_mm: Annotated[
        float, Field(description="What it adds to the figure: |sensitivity| times `input_uncertainty`, mm.")
    ]
    degrees_of_freedom: Annotated[
        float | None, Field(description="Of the input's uncertainty; null: infinite.")
    ]
    share: Annotated[float, Field(description="Of the figure's variance, 0 to 1.")]


class MonteCarloCheck(ResponseModel):
    """The figure by sampling its inputs (GUM Supplement 1)."""

    trials: Annotated[int, Field(description="Draws of every input.")]
    standard_uncertainty_mm: Annotated[float, Field(description="Standard deviation of the draws, mm.")]
    interval_mm: Annotated[
        Interval, Field(description="[low, high] of the figure at the confidence level, mm.")
    ]
    difference_mm: Annotated[
        float,
        Field(description="The larger distance of its ends from value ± expanded uncertainty, mm."),
    ]
    tolerance_mm: Annotated[
        float,
        Field(
            description="Half of the last place of the standard uncertainty written with one digit, mm (JCGM 101, 8.1)."
        ),
    ]
    agrees: Annotated[
        bool,
        Field(
            description="Whether the difference is within the tolerance; if not, the figure's distribution is not "
            "symmetric, or not normal: take the intervals."
        ),
    ]


class BudgetTotal(_OfFigure):
    """The combined uncertainty of one figure."""

    value_mm: Annotated[float, Field(description="The figure, mm.")]
    standard_uncertainty_mm: Annotated[float, Field(description="Combined standard uncertainty, mm.")]
    degrees_of_freedom: Annotated[
        float | None, Field(description="Effective ones (Welch-Satterthwaite); null: infinite.")
    ]
    coverage_factor: Annotated[
        float, Field(description="k: Student's t of the degrees of freedom at the confidence level.")
    ]
    expanded_uncertainty_mm: Annotated[
        float, Field(description="U: coverage factor times standard uncertainty, mm.")
    ]
    interval_mm: Annotated[
        Interval | None,
        Field(description="The figure's interval as the analysis states it, mm; null: it has none."),
    ]
    monte_carlo: Annotated[
        MonteCarloCheck | None, Field(description="By sampling; null unless `method=monte_carlo`.")
    ]
