"""How well an identified robot predicts poses that had no part in the fit, as JSON."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.common import ResponseModel

Blocking = TypeAliasType(
    "Blocking",
    Annotated[
        Literal["elbow", "height", "order", "clusters"],
        Field(
            description="What poses of one block share: the third joint's angle, the height of the camera above the "
            "base, their place in the order of measuring, or a region of joint space (k-means)."
        ),
    ],
)


class PoseErrors(ResponseModel):
    """Root mean squares of distances and of rotation angles; the latter null for positions alone."""

    position_rms_mm: Annotated[
        float, Field(description="Root mean square of the distances, predicted to measured position, mm.")
    ]
    rotation_rms_deg: Annotated[
        float | None,
        Field(
            description="Root mean square of the angles, predicted to measured rotation, degrees; null for positions "
            "alone."
        ),
    ]


class DhBlocks(PoseErrors):
    """Errors at blocks of joint space, each predicted by the poses of all others."""

    blocking: Annotated[Blocking, Field(description="What poses of one block share.")]
    block_count: Annotated[int, Field(description="How many blocks there are.")]
    nominal: Annotated[
        PoseErrors | None,
        Field(
            description="The nominal robot at the same poses, its tool and base fitted to the other blocks."
        ),
    ]


class DhValidation(PoseErrors):
    """Errors at poses that had no part in the fit: all are dealt into five folds, each predicted by the rest, with base
    and tool fitted to these.
    """

    held_out_poses: Annotated[int, Field(description="How many poses were held out, over all folds.")]
    outlier_poses: Annotated[
        int,
        Field(description="Poses that the fit of all poses rejects as gross errors; they are not predicted."),
    ]
    random: Annotated[PoseErrors, Field(description="The same errors: of folds dealt at random.")]
    blocked: Annotated[
        PoseErrors | None,
        Field(
            description="Errors at clusters of joint space, each predicted by the others: what the identification is "
            "worth away from the poses. Null with fewer than 80 configurations, and with methods that begin at axes."
        ),
    ]
    nominal: Annotated[
        PoseErrors | None,
        Field(description="The nominal robot at the same poses, its tool and base fitted to the rest."),
    ]
    blocks: Annotated[
        list[DhBlocks],
        Field(description="Errors at blocks by elbow angle, height, order of measuring, and clusters."),
    ]
