"""Tables of analyses: what is a vector in the JSON is columns in the CSV."""

from __future__ import annotations

import inspect

import pytest
from pydantic import BaseModel

from app.api.representations.analysis_tables import tables_of
from app.api.schemas import analyses

MODELS = [
    model
    for name, model in inspect.getmembers(analyses, inspect.isclass)
    if issubclass(model, BaseModel) and name.endswith("Analysis")
]


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
def test_positions_have_a_column_for_each_coordinate(model: type[BaseModel]) -> None:
    for table in tables_of(model).values():
        assert not [name for name in table.header if name.endswith("position_mm")], table.name


def test_camera_poses_have_three_coordinates() -> None:
    header = tables_of(analyses.CameraPosesAnalysis)["camera_poses"].header
    assert [name for name in header if "position" in name] == [f"pose_position_{axis}_mm" for axis in "xyz"]


def test_roll_pitch_and_yaw_have_their_names() -> None:
    header = tables_of(analyses.RepeatabilityAnalysis)["poses"].header
    scatter = [name.removeprefix("orientation_scatter_") for name in header if "orientation_scatter" in name]
    vector = [f"rotation_vector_{axis}_deg" for axis in "xyz"]
    assert scatter == [*vector, "roll_deg", "pitch_deg", "yaw_deg"]
