"""Stored documents under the names of the HTTP contract: labelling, initialisation, limits of joints.

Revision: 0010, after 0009
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import sqlalchemy as sa
from alembic import op

from migrations.documents import rewrite_documents

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None
lost_on_the_way_down = "How likely the second pose of a plane is, of stored calibrations, until a retry."

_LABELLING = {"known": "absolute", "turned": "up_to_symmetry", "unknown": "partial"}
_JOINT = {"lower_deg": "minimum_deg", "upper_deg": "maximum_deg"}
_CALIBRATION = {"start": "initialisation"}
_POSE = {"conditional_covariance": "covariance_given_camera"}
# The value before was another statistic, which the stored document does not convert to this one.
_RECOMPUTED = ("pose_ambiguity_ratio", "ambiguity_log_likelihood_ratio")
Renamed = Callable[[Any], Any]


def _names(document: Any, names: Mapping[str, str]) -> Any:
    """Return a document under other names; what is no document, such as a damaged one, as it is."""
    if not isinstance(document, dict):
        return document
    return {names.get(name, name): value for name, value in document.items()}


def _inverse(names: Mapping[str, str]) -> dict[str, str]:
    return {new: old for old, new in names.items()}


def _renamed_joints(names: Mapping[str, str]) -> Renamed:
    return lambda joints: [_names(joint, names) for joint in joints] if isinstance(joints, list) else joints


def _renamed_calibration(names: Mapping[str, str], pose: Mapping[str, str], old: str, new: str) -> Renamed:
    def renamed(document: Any) -> Any:
        document = _names(document, names)
        if isinstance(document, dict):
            if "pose" in document:
                document["pose"] = _names(document["pose"], pose)
            if isinstance(document.get("observability"), dict):
                known = {name: value for name, value in document["observability"].items() if name != old}
                document["observability"] = {**known, new: None}
        return document

    return renamed


def _relabel(column: str, words: Mapping[str, str]) -> None:
    results = sa.table("results", sa.column(column, sa.String))
    for old, new in words.items():
        op.execute(sa.update(results).where(results.c[column] == old).values({column: new}))


def upgrade() -> None:
    op.alter_column("results", "origin", new_column_name="labelling")
    op.alter_column("robots", "repeatability_mm", new_column_name="datasheet_repeatability_mm")
    _relabel("labelling", _LABELLING)
    rewrite_documents("robots", "id", "joints", _renamed_joints(_JOINT))
    rewrite_documents(
        "results", "measurement_id", "calibration", _renamed_calibration(_CALIBRATION, _POSE, *_RECOMPUTED)
    )


def downgrade() -> None:
    rewrite_documents(
        "results",
        "measurement_id",
        "calibration",
        _renamed_calibration(_inverse(_CALIBRATION), _inverse(_POSE), *reversed(_RECOMPUTED)),
    )
    rewrite_documents("robots", "id", "joints", _renamed_joints(_inverse(_JOINT)))
    _relabel("labelling", _inverse(_LABELLING))
    op.alter_column("robots", "datasheet_repeatability_mm", new_column_name="repeatability_mm")
    op.alter_column("results", "labelling", new_column_name="origin")
