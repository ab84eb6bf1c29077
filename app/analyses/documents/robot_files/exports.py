"""The files that a report on a robot's kinematics carries, by their names."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from app.analyses.documents.robot_files.error_terms import write_terms_json
from app.analyses.documents.robot_files.model_files import (
    Model,
    names_of,
    ranges_of,
    write_csv,
    write_urdf,
    write_yaml,
)

CHAIN_FILES = ("robot.urdf", "robot.csv")
"""Files that hold a chain alone: of a robot with terms beyond it they are made from the analysis with model dh."""


def exports_of(
    document: dict[str, Any],
    robot: dict[str, Any] | None,
    session_name: str,
    chain: dict[str, Any] | None = None,
) -> dict[str, str]:
    """Return the identified robot as YAML and URDF, as CSV where its joints turn each by itself, and its further terms.

    `document` is the analysis `dh`, `robot` the data sheet that it was identified from, `chain` the analysis with
    model dh, from which `CHAIN_FILES` are then made.
    """
    joints = robot["joints"] if robot is not None else [{} for _ in document["joints"]]
    model = Model(
        document,
        robot["name"] if robot is not None else session_name,
        names_of([joint.get("name") for joint in joints]),
        ranges_of([(joint.get("minimum_deg"), joint.get("maximum_deg")) for joint in joints]),
        with_camera=True,
    )
    alone = model if chain is None else replace(model, document=chain)
    found = {"robot.yaml": write_yaml(model), "robot.urdf": write_urdf(alone)}
    if document["joint_coupling"] is None:
        found["robot.csv"] = write_csv(alone)
    if document["error_model"] is not None:
        found["terms.json"] = write_terms_json(model)
    return found
