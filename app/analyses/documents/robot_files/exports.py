"""The files that a report on a robot's kinematics carries, by their names."""

from __future__ import annotations

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


def exports_of(document: dict[str, Any], robot: dict[str, Any] | None, session_name: str) -> dict[str, str]:
    """Return the identified robot as YAML and URDF, as CSV where its joints turn each by itself, and its further terms.

    `document` is the analysis `dh`, `robot` the data sheet that it was identified from.
    """
    joints = robot["joints"] if robot is not None else [{} for _ in document["joints"]]
    model = Model(
        document,
        robot["name"] if robot is not None else session_name,
        names_of([joint.get("name") for joint in joints]),
        ranges_of([(joint.get("minimum_deg"), joint.get("maximum_deg")) for joint in joints]),
        with_camera=True,
    )
    found = {"robot.yaml": write_yaml(model), "robot.urdf": write_urdf(model)}
    if document["joint_coupling"] is None:
        found["robot.csv"] = write_csv(model)
    if document["error_model"] is not None:
        found["terms.json"] = write_terms_json(model)
    return found
