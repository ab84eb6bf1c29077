"""A session's camera as a file of other programs, read by their readers where there are any."""

from __future__ import annotations

import ast
import dataclasses
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from core.geometry import KannalaBrandtCamera
from tests.app.analyses.cameras.test_lens_model import stored
from tests.support.sessions.stored_sessions import Store, body, new_session, problem, shoot
from tests.support.simulation.wide_lenses import look_around

SYSTEM_PYTHON = "/usr/bin/python3"
ROUNDED = 1e-8
"""Coefficients in the JSON are rounded to what their uncertainty supports, in files they are not."""
INNER = ("fx_px", "fy_px", "cx_px", "cy_px")


def export(api: Any, session: str, kind: str, **query: Any) -> Any:
    return api.client.get(f"/v1/sessions/{session}/intrinsics/export", params={"format": kind, **query})


def text_of(answer: Any) -> str:
    assert answer.status_code == 200, answer.text
    return str(answer.text)


def stated_error_px(text: str) -> float:
    found = re.search(r"^# largest_conversion_error_px: (\S+)$", text, re.MULTILINE)
    assert found
    return float(found[1])


def camera_of(api: Any, session: str) -> dict[str, float]:
    (group,) = body(api.client.get(f"/v1/sessions/{session}/intrinsics"))["groups"]
    return {**group["intrinsics"], **group["distortion"]}


def mrcal_reads(path: Path) -> dict[str, Any]:
    """Read a .cameramodel by mrcal itself, which Debian has for the system's own Python."""
    script = (
        "import json, sys, mrcal\n"
        "m = mrcal.cameramodel(sys.argv[1])\n"
        "model, values = m.intrinsics()\n"
        "q = mrcal.project(__import__('numpy').array([[.1, -.05, 1.]]), model, values)\n"
        "print(json.dumps([model, values.tolist(), m.imagersize().tolist(), q.tolist(),"
        " len(m.valid_intrinsics_region())]))"
    )
    if shutil.which(SYSTEM_PYTHON) is None:
        pytest.skip("no Python of the system")
    if subprocess.run([SYSTEM_PYTHON, "-c", "import mrcal"], capture_output=True, check=False).returncode:
        pytest.skip("mrcal is not installed (apt-get install python3-mrcal)")
    run = subprocess.run([SYSTEM_PYTHON, "-c", script, str(path)], capture_output=True, text=True, check=True)
    model, values, size, pixel, rim = json.loads(run.stdout)
    return {"model": model, "values": values, "size": size, "pixel": pixel, "rim": rim}


@pytest.fixture
def plain(api: Any, store: Store) -> str:
    session = new_session(api)
    store(api, session, shoot(poses=5, cycles=1))
    return str(session)


@pytest.mark.slow
def test_a_plain_lens_is_written_without_loss_in_every_format(api: Any, plain: str, tmp_path: Path) -> None:
    camera = camera_of(api, plain)
    inner = [camera[name] for name in INNER]
    five = [camera[name] for name in ("k1", "k2", "p1", "p2", "k3")]
    for kind in ("opencv", "ros", "kalibr", "mrcal"):
        assert stated_error_px(text_of(export(api, plain, kind))) == 0.0
    opencv = export(api, plain, "opencv")
    assert opencv.headers["Content-Type"].startswith("application/yaml")
    assert 'filename="camera.yaml"' in opencv.headers["Content-Disposition"]
    path = tmp_path / "camera.yaml"
    path.write_text(opencv.text)
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    matrix = storage.getNode("camera_matrix").mat()
    assert [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]] == pytest.approx(inner, rel=1e-7)
    assert storage.getNode("distortion_coefficients").mat().ravel().tolist() == pytest.approx(
        five, rel=1e-5, abs=ROUNDED
    )
    ros = yaml.safe_load(text_of(export(api, plain, "ros")))
    assert ros["distortion_model"] == "plumb_bob"
    assert ros["camera_matrix"]["data"] == pytest.approx(
        [inner[0], 0, inner[2], 0, inner[1], inner[3], 0, 0, 1], rel=1e-7
    )
    assert ros["distortion_coefficients"]["data"] == pytest.approx(five, rel=1e-5, abs=ROUNDED)
    assert len(ros["projection_matrix"]["data"]) == 12
    kalibr = yaml.safe_load(text_of(export(api, plain, "kalibr")))["cam0"]
    assert (kalibr["camera_model"], kalibr["distortion_model"]) == ("pinhole", "radtan")
    assert kalibr["intrinsics"] == pytest.approx(inner, rel=1e-7)
    assert kalibr["distortion_coeffs"] == pytest.approx(five[:4], rel=1e-5, abs=ROUNDED)
    mrcal = ast.literal_eval(text_of(export(api, plain, "mrcal")))
    assert mrcal["lensmodel"] == "LENSMODEL_OPENCV5"
    assert mrcal["intrinsics"] == pytest.approx([*inner, *five], rel=1e-5, abs=ROUNDED)


def test_mrcal_reads_its_file_and_sees_the_same_pixels(api: Any, plain: str, tmp_path: Path) -> None:
    camera = camera_of(api, plain)
    path = tmp_path / "camera.cameramodel"
    path.write_text(text_of(export(api, plain, "mrcal")))
    found = mrcal_reads(path)
    five = np.array([camera[name] for name in ("k1", "k2", "p1", "p2", "k3")])
    matrix = np.array(
        [[camera["fx_px"], 0, camera["cx_px"]], [0, camera["fy_px"], camera["cy_px"]], [0, 0, 1]]
    )
    expected, _ = cv2.projectPoints(np.array([[0.1, -0.05, 1.0]]), np.zeros(3), np.zeros(3), matrix, five)
    assert found["model"] == "LENSMODEL_OPENCV5"
    assert np.ravel(found["pixel"]) == pytest.approx(expected.ravel(), abs=1e-3)
    assert found["rim"] > 4


def test_a_wide_lens_is_converted_and_the_file_says_by_how_much(api: Any, store: Store) -> None:
    lens = KannalaBrandtCamera(570.0, 570.5, 640.0, 485.0, 0.1, -0.02, 0.004)
    session = stored(api, store, look_around(np.random.default_rng(4), lens, images=6, sigma_px=0.02))
    # The formats' angular model has no tangential terms; the rational one may come nearer.
    for kind, models in (
        ("opencv", ("fisheye", "rational")),
        ("ros", ("equidistant", "rational_polynomial")),
        ("kalibr", ("equidistant",)),
    ):
        text = text_of(export(api, session, kind))
        assert any(f"distortion_model: {model}\n" in text for model in models)
        assert 0.0 <= stated_error_px(text) <= 0.5
    in_mrcal = export(api, session, "mrcal")
    if in_mrcal.status_code == 200:
        assert "LENSMODEL_OPENCV8" in in_mrcal.text
        assert 0.0 < stated_error_px(in_mrcal.text) <= 0.5
    else:
        advice = problem(in_mrcal, 409, "not_representable")["advice"]
        assert {kind for kind in ("opencv", "ros", "kalibr", "mrcal") if kind in advice} == {
            "opencv",
            "ros",
            "kalibr",
        }
    brown = export(api, session, "ros", lens_model="brown")
    assert "plumb_bob" in brown.text


def test_a_refused_format_is_not_advised(api: Any, store: Store) -> None:
    """An angular lens off its centre: no angular model of a format has the tangential terms."""
    lens = KannalaBrandtCamera(570.0, 570.5, 640.0, 485.0, 0.1, -0.02, 0.004, 0.0, 0.003, -0.003)
    session = stored(api, store, look_around(np.random.default_rng(4), lens, images=6, sigma_px=0.02))
    answers = {kind: export(api, session, kind) for kind in ("opencv", "ros", "kalibr", "mrcal")}
    taken = {kind for kind, answer in answers.items() if answer.status_code == 200}
    assert "kalibr" not in taken
    for kind in answers.keys() - taken:
        advice = problem(answers[kind], 409, "not_representable")["advice"]
        assert {one for one in answers if one in advice} == taken
        assert "JSON" in advice


def test_a_file_holds_one_focus_group(api: Any, store: Store) -> None:
    session = new_session(api)
    shots = shoot(poses=5, cycles=1)
    store(
        api,
        session,
        [*shots, *(dataclasses.replace(s, cycle=2, fields={"focus_group": "far"}) for s in shots)],
    )
    problem(export(api, session, "ros"), 409, "focus_group_required")
    assert export(api, session, "ros", focus_group="far").status_code == 200
    problem(export(api, session, "ros", focus_group="near"), 404, "focus_group_not_found")


def test_stated_intrinsics_of_few_digits_are_numbers_to_every_reader(api: Any, plain: str) -> None:
    """To PyYAML, which reads the files of ROS and Kalibr, 1e-05 is a text: YAML 1.1 has a point in every float."""
    stated = {"fx_px": 1160, "fy_px": 1160, "cx_px": 605, "cy_px": 515}
    lens = {"k1": -0.1, "k2": 0.05, "p1": 1e-5, "p2": -2e-5, "k3": 0}
    body(api.client.patch(f"/v1/sessions/{plain}", json={"intrinsics": {**stated, **lens}}))
    ros = yaml.safe_load(text_of(export(api, plain, "ros", estimator="given")))
    assert ros["distortion_coefficients"]["data"] == list(lens.values())
    kalibr = yaml.safe_load(text_of(export(api, plain, "kalibr", estimator="given")))["cam0"]
    assert kalibr["distortion_coeffs"] == list(lens.values())[:4]
    assert kalibr["intrinsics"] == list(stated.values())
    assert all(isinstance(value, float) for value in kalibr["intrinsics"])


def test_requests_that_name_no_file(api: Any, store: Store) -> None:
    session = new_session(api)
    problem(export(api, session, "ros"), 409, "too_few_measurements")
    problem(export(api, session, "blender"), 422, "invalid_request")
