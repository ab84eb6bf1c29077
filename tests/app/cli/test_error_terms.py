"""Curves and compliance as files, and the table of joint angles to command."""

from __future__ import annotations

import csv
import io
import json
from typing import Any

import numpy as np
import pytest

from app.analyses.documents.robot_files.error_terms import (
    CURVE_COLUMNS,
    NoTerms,
    angles_to_command,
    write_angle_table,
    write_terms_csv,
    write_terms_json,
)
from app.analyses.documents.robot_files.model_files import Model
from app.cli.robots.export import statements

ANGLES = np.arange(-50.0, 51.0, 2.0)
CURVE = 0.05 * np.sin(np.radians(3.0 * ANGLES))


def model(**changes: Any) -> Model:
    curve = {
        "joint": 2,
        "angles_deg": ANGLES.tolist(),
        "correction_deg": CURVE.tolist(),
        "standard_uncertainty_deg": np.full(len(ANGLES), 0.004).tolist(),
    }
    compliance = {"joint": 1, "axis": "x", "rad_per_m": 2e-4, "standard_uncertainty_rad_per_m": 3e-5}
    approach = {"joint": 2, "offset_deg": -0.012, "offset_standard_uncertainty_deg": 0.001}
    gaps = [{"minimum_deg": -10.0, "maximum_deg": 6.0}]
    document = {
        **{"session_id": "ses_1", "inputs_sha256": "0" * 64, "core_version": "0.1.0"},
        **{"source": "images", "estimator": "pooled", "joint_coupling": None},
        "level": {"chosen": "all", "reason": "Level: all.", "gain": "Gain: much."},
        "region": {
            "joints": [{"joint": 2, "minimum_deg": -50.0, "maximum_deg": 50.0, "gaps": gaps}],
        },
        "error_model": {"joint_curves": [curve], "compliance": [compliance], "approach_offsets": [approach]},
        **changes,
    }
    return Model(document, "arm", ("base", "=lift"), (None, None), True)


def rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_a_commanded_angle_turns_the_joint_to_the_wanted_one() -> None:
    wanted = np.linspace(-48.0, 48.0, 97)
    command = angles_to_command(wanted, ANGLES, CURVE)
    np.testing.assert_allclose(command + np.interp(command, ANGLES, CURVE), wanted, atol=1e-12)
    assert np.abs(command - wanted).max() == pytest.approx(0.05, rel=0.01)


def test_the_table_has_every_degree_and_says_where_the_joint_never_was() -> None:
    table = rows(write_angle_table(model()))
    assert [float(row["wanted_deg"]) for row in table] == list(range(-50, 51))
    assert {row["name"] for row in table} == {"=lift"}
    assert {float(row["wanted_deg"]) for row in table if row["visited"] == "no"} == set(range(-9, 6))
    for row in table:
        off = float(row["command_deg"]) - float(row["wanted_deg"])
        assert off == pytest.approx(float(row["correction_deg"]), abs=2e-5)


def test_terms_are_kept_with_every_digit() -> None:
    one = model()
    found = json.loads(write_terms_json(one))
    assert found["joint_curves"] == one.document["error_model"]["joint_curves"]
    assert found["compliance"] == one.document["error_model"]["compliance"]
    assert found["level"]["chosen"] == "all"
    table = rows(write_terms_csv(one))
    assert tuple(table[0]) == CURVE_COLUMNS
    curve = [row for row in table if row["term"] == "joint_curve"]
    assert [float(row["value"]) for row in curve] == CURVE.tolist()
    (compliance,) = (row for row in table if row["term"] == "compliance")
    assert (compliance["joint"], compliance["axis"], compliance["unit"]) == ("1", "x", "rad/m")
    (approach,) = (row for row in table if row["term"] == "approach")
    assert (approach["joint"], approach["value"], approach["unit"]) == ("2", "-0.012", "deg")


def test_a_chain_alone_has_no_terms_to_write() -> None:
    for write in (write_terms_json, write_terms_csv, write_angle_table):
        with pytest.raises(NoTerms, match="Level: all"):
            write(model(error_model=None))
    with pytest.raises(NoTerms, match="no joint curves"):
        write_angle_table(model(error_model={"joint_curves": [], "compliance": [], "approach_offsets": []}))


def test_export_says_in_a_line_each_what_was_chosen_what_it_gains_and_where_it_holds() -> None:
    document = model().document
    assert statements(document) == [
        "Level: all.",
        "Gain: much.",
        "Holds within: joint 2 -50° to 50° (without gaps over 10°: 1).",
    ]
    assert statements({**document, "level": None}) == []
