"""Reports name things as their readers do: no id, field, setting, code or request of the service is in them."""

from __future__ import annotations

import ast
import copy
import json
import re
import tarfile
from typing import Any

import pytest

from app.reports.forms import CompanyTemplate, render_forms
from app.reports.forms.wording import Wording, symbols, words
from tests.reference.archives.make import FOLDER
from tests.support.report_texts import TECHNICAL, technical_words
from tests.support.source_texts import modules, texts_of

TARGET, IMAGE, BARE, GONE = (
    f"{kind}_{digit * 26}" for kind, digit in (*(("tgt", "1"), ("mea", "2")), *(("mea", "3"), ("mea", "4")))
)

INPUTS: dict[str, Any] = {
    "session": {"id": f"ses_{'0' * 26}", "name": "Cell 4"},
    "robot": {"id": f"rob_{'0' * 26}", "name": "KR 5"},
    "targets": [{"id": TARGET, "name": "board_of=cell"}],
    "poses": [{"pose_id": "home_left"}],
    "images": [
        {
            "measurement_id": IMAGE,
            "pose_id": "home_left",
            "cycle": 3,
            "filename": "img_0003.png",
            "focus_group": "near_by",
        },
        {
            "measurement_id": BARE,
            "pose_id": "P2",
            "cycle": None,
            "filename": None,
            "focus_group": "default",
            "sha256": "abcdef0123456789",
        },
    ],
    "measured_poses": [],
}


@pytest.fixture(scope="module")
def documents() -> list[dict[str, Any]]:
    """Reports that an earlier version stored."""
    with tarfile.open(FOLDER / "schema-0019.tar.gz") as archive:
        return [
            json.load(archive.extractfile(member))  # type: ignore[arg-type]
            for member in archive
            if member.name.endswith("/report.json")
        ]


@pytest.mark.parametrize(
    ("text", "read"),
    [
        (f"The scale of {TARGET} is not stated.", "The scale of board_of=cell is not stated."),
        (
            f"Excluded: {IMAGE}, {BARE}.",
            "Excluded: img_0003.png (home_left, cycle 3), P2 (SHA-256 abcdef01).",
        ),
        (f"It was {GONE}.", "It was an image."),
        ("Pose home_left in img_0003.png of 'near_by'.", "Pose home_left in img_0003.png of 'near_by'."),
        ("Use estimator=pooled_free_focal here.", "Use the estimator “pooled, free focal length” here."),
        ("Subtract it (`subtract_witness=true`).", "Subtract it (with “subtract witness”)."),
        ("State pitch_standard_uncertainty_mm.", "State the standard uncertainty of its pitch."),
        ("Send joint_angles_deg with rpy_deg.", "Send joint angles with rpy."),
        ("Of estimator per_image.", "Of estimator “each image alone”."),
        ("Exclude it (PATCH /v1/x/{id}, `gridpose x`) now.", "Exclude it now."),
        ("PUT the poses. Then POST it.", "State the poses. Then send it."),
        ("RP_l of 0.1 mm, U = k u, 5 % (k3).", "RP_l of 0.1 mm, U = k u, 5 % (k3)."),
    ],
)
def test_a_text_is_read_with_names_and_words(text: str, read: str) -> None:
    assert Wording.of(INPUTS).text(text) == read
    assert Wording.of(INPUTS).text(read) == read, "what is in words stays"


def test_every_sentence_of_the_numerics_is_fit_for_a_report() -> None:
    wording = Wording.of(INPUTS)
    sentences = {
        text
        for path in modules("core")
        if "comparison" not in path.parts and path.name not in ("jit.py", "code_cache.py")
        for text in texts_of(ast.parse(path.read_text(encoding="utf-8")))
        if text.count(" ") > 2 and re.search(r"[a-z…)]\.(?:$| )", text)
    }
    assert len(sentences) > 200
    assert not {said for text in sentences if TECHNICAL.search(said := wording.text(text))}


def test_stored_reports_say_nothing_that_their_readers_do_not_know(documents: list[dict[str, Any]]) -> None:
    assert len(documents) > 1
    for document in documents:
        assert not technical_words(render_forms(document, {}, CompanyTemplate()), document)


def test_texts_with_ids_settings_and_fields_are_read_in_every_form(documents: list[dict[str, Any]]) -> None:
    document = copy.deepcopy(next(one for one in documents if one["kind"] == "repeatability"))
    target, image = document["inputs"]["targets"][0], document["inputs"]["images"][0]
    found = document["analyses"]["repeatability"]
    found["warnings"] = [
        {
            "code": "made_up",
            "detail": f"{target['id']} and {image['measurement_id']} have noise_floor null_b.",
            "advice": "Use estimator=per_image (PATCH /v1/sessions/{session_id}).",
        }
    ]
    found["excluded"] = [
        {
            "measurement_id": image["measurement_id"],
            "filename": None,
            "code": "image_degraded",
            "detail": f"As {image['measurement_id']} says.",
        }
    ]
    forms = render_forms(document, {}, CompanyTemplate())
    assert not technical_words(forms, document)
    said = f"{target['name']} and "
    for form in ("html", "xml"):
        assert said in forms[form].decode()
        assert "Use the estimator “each image alone”." in forms[form].decode()
    assert f"{target['id']} and {image['measurement_id']}" in forms["json"].decode(), "programs keep the ids"


def test_parameters_of_a_robot_are_written_as_tables_have_them() -> None:
    said = symbols("theta1 offset and d1, alpha6, beta2 and theta12 offset; thetas stay.")
    assert said == "θ1 and d1, α6, β2 and θ12; thetas stay."


def test_codes_are_read_as_words() -> None:
    assert words("below_detection") == "below detection"
    assert words("kannala_brandt") == "Kannala-Brandt"
