"""Commands to correct, and corrected ones, as JSON."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.analyses.common import EstimatedAnalysis, EstimatorField, SourceField
from app.api.schemas.analyses.dh.error_model import ErrorTerm, RegionRead
from app.api.schemas.analyses.dh.validation import PoseErrors
from app.api.schemas.common import Identifier, RequestModel, ResponseModel
from app.api.schemas.poses import CommandRead, CommandWrite, PoseReference

MAX_COMMANDS = 5000
CommandOutcome = TypeAliasType(
    "CommandOutcome",
    Annotated[
        Literal[
            "corrected",
            "in_gap",
            "near_singularity",
            "outside_region",
            "beyond_limits",
            "too_far",
            "not_reachable",
        ],
        Field(description="What was done with a command."),
    ],
)
CurvesBasis = TypeAliasType(
    "CurvesBasis",
    Annotated[
        Literal["requested", "confirmed", "not_confirmed", "no_second_session", "not_supported"],
        Field(description="Why joint curves are part of a correction, or are not."),
    ],
)


class CommandToCorrect(CommandWrite, PoseReference):
    """A command: joint angles, or a whole pose of the flange in the robot's base, or both."""


class CompensationCreate(RequestModel):
    """Commands to correct by what a session of the robot identified."""

    session_id: Annotated[
        Identifier, Field(description="Id of the session that the robot is identified from.")
    ]
    poses: Annotated[
        list[CommandToCorrect],
        Field(min_length=1, max_length=MAX_COMMANDS, description="Commands; 5,000 at most."),
    ]
    confirming_session_id: Annotated[
        Identifier | None,
        Field(
            description="Id of a second session of the same robot: joint curves count in the correction if they "
            "predict its poses, too. Null: they count only with `curves=true`."
        ),
    ] = None
    estimator: EstimatorField = "pooled"
    source: SourceField = "images"


class CorrectedCommand(CommandRead):
    """A command as it is to be sent; unchanged where it could not be corrected."""

    outcome: Annotated[
        CommandOutcome,
        Field(
            description="`corrected`; `in_gap`: corrected, with a joint in a gap of over 10° among the angles that "
            "were measured; `near_singularity`: corrected but for a part of the rotation. What an arm has too few axes "
            "to correct is left everywhere (warning `correction_partial`). Left as it was: "
            "`outside_region` (a joint outside the angles that were measured), `beyond_limits` (of the robot's "
            "joints), `too_far` (a joint would turn by over 2°, or the command is nearer as it was), `not_reachable` "
            "(no joint angles attain the pose)."
        ),
    ]
    applied: Annotated[bool, Field(description="Whether the command was corrected.")]
    uncorrected_error_mm: Annotated[
        float | None,
        Field(description="How far the flange's end would be off without the correction, by the model, mm."),
    ]
    uncorrected_error_deg: Annotated[float | None, Field(description="The same of its rotation, degrees.")]
    expected_residual_mm: Annotated[
        float | None,
        Field(
            description="Expected error of the position that is left, root mean square, mm: of the model, grown to "
            "what held-out poses show, and of the robot's scatter. Null where the command is not corrected."
        ),
    ]
    expected_residual_deg: Annotated[
        float | None,
        Field(
            description="The same of the rotation, degrees; null also where positions alone were measured."
        ),
    ]


class CorrectionGain(ResponseModel):
    """Errors at the same held-out poses, with and without the correction."""

    with_correction: Annotated[
        PoseErrors | None, Field(description="Of the model that corrects; null: too few poses.")
    ]
    nominal: Annotated[
        PoseErrors | None, Field(description="Of the nominal robot with its best base and tool.")
    ]
    position_ratio: Annotated[
        float | None, Field(description="Position error with the correction over the nominal.")
    ]


class CompensationValidation(ResponseModel):
    """What the correction gains on poses that had no part in it."""

    random_gain: Annotated[CorrectionGain, Field(description="At folds dealt at random.")]
    blocked_gain: Annotated[
        CorrectionGain,
        Field(description="At whole clusters of joint space, each predicted by the others."),
    ]


class CompensationCurves(ResponseModel):
    """Whether joint curves are part of the correction, and why."""

    applied: Annotated[bool, Field(description="Whether they are.")]
    basis: Annotated[
        CurvesBasis,
        Field(
            description="`requested`: by `curves=true`. `confirmed`, `not_confirmed`: by the second session. "
            "`no_second_session`: none was named. `not_supported`: this session's poses do not speak for curves."
        ),
    ]
    confirming_ratio: Annotated[
        float | None,
        Field(
            description="Position error at the second session's poses with this session's curves by that without "
            "them; below 0.95 they are confirmed. Null where it was not determined."
        ),
    ]
    failure_code: Annotated[
        str | None,
        Field(
            description="The code of the reason where the second session's robot cannot be identified; else null."
        ),
    ]


class Compensation(EstimatedAnalysis):
    """Corrected commands, by what a session identified of the robot."""

    robot_id: Annotated[str, Field(description="Id of the robot; opaque, made by the server.")]
    source: SourceField
    terms: Annotated[list[ErrorTerm], Field(description="Terms beyond the chain that correct.")]
    curves: Annotated[CompensationCurves, Field(description="Whether joint curves correct, and why.")]
    validation: Annotated[CompensationValidation, Field(description="What the correction gains.")]
    region: Annotated[
        RegionRead, Field(description="Where joints were measured: nothing is corrected outside.")
    ]
    poses: Annotated[list[CorrectedCommand], Field(description="The commands, in the order sent.")]
