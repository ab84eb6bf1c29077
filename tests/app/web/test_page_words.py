"""What pages say of the API's texts: no request, command or id where a page has a button or a name."""

from __future__ import annotations

import ast
import re
from types import SimpleNamespace
from typing import Any, cast

import pytest

from app.jobs.process_image import _CORRECTION
from app.web.page_words import linked, named, next_page, next_page_here, on_pages
from app.web.pages import environment
from app.web.routes.measurements import camera_meaning
from app.web.words import ESTIMATORS
from core.errors import (
    CommandedPosesMissing,
    FocalNotObservable,
    GridposeError,
    IntrinsicsMissing,
    MixedImageSizes,
    TooFewCycles,
)
from tests.support.source_texts import modules, texts_of

TARGET, SESSION = "tgt_" + "0" * 26, "ses_" + "1" * 26
TECHNICAL = re.compile(r"`|\bgridpose [a-z]|\b(?:PATCH|POST|DELETE|PUT|GET)\b|/v1/|\w=\w|[a-z]_[a-z]")


def descendants(of: type[GridposeError]) -> list[type[GridposeError]]:
    return [of, *(one for child in of.__subclasses__() for one in descendants(child))]


@pytest.mark.parametrize("error", [one for one in descendants(GridposeError) if one.default_advice])
def test_no_advice_of_the_numerics_speaks_of_requests_or_fields(error: type[GridposeError]) -> None:
    assert not TECHNICAL.search(on_pages(error.default_advice or "")), on_pages(error.default_advice or "")


@pytest.mark.parametrize(
    ("advice", "shown"),
    [
        (IntrinsicsMissing.default_advice, "Choose another estimator."),
        (
            MixedImageSizes.default_advice,
            "Give each camera setting a focus group of its own: on the page of images, select its images and choose "
            "Correct.",
        ),
        (CommandedPosesMissing.default_advice, "State position, roll, pitch and yaw."),
        (
            _CORRECTION,
            "If the session states the wrong target, change its target: its images are searched again.",
        ),
        (
            "Use estimator=pooled, or give intrinsics of this very focus.",
            f"Use the estimator “{ESTIMATORS['pooled'][0]}”, or give intrinsics of this very focus.",
        ),
        (
            "A measurement can be excluded (PATCH /v1/measurements/{measurement_id}, `gridpose measurements exclude`).",
            "A measurement can be excluded.",
        ),
        (
            "2 of 31 images are not in the figures: focal_not_observable (1), target_not_found (1).",
            "2 of 31 images are not in the figures: focal not observable (1), target not found (1).",
        ),
    ],
)
def test_an_advice_is_in_the_words_of_the_pages(advice: str, shown: str) -> None:
    assert on_pages(advice) == shown


@pytest.mark.parametrize(
    ("field", "words"),
    [
        *(("pose_id", "pose"), ("3.pose_id", "pose"), ("joints.0.theta_offset_deg", "joint 1, θ offset")),
        *(("target_ids.1", "target 2"), ("signatories.0.name", "signer 1, name"), ("0", "")),
        *(("conditions.temperature_c", "conditions, temperature"), ("joint_angles_deg.2", "joint angle 3")),
    ],
)
def test_a_field_has_the_name_that_pages_give_it(field: str, words: str) -> None:
    assert named(field) == words


@pytest.mark.parametrize(
    ("figure", "shown"),
    [
        ("RP_l", "RP<sub>l</sub>"),
        ("noise floor", "noise floor"),
        ("alpha_deg", "α"),
        ("fx_px", "fx"),
        ("a_mm", "a"),
    ],
)
def test_a_figure_of_histories_has_no_unit_in_its_name(figure: str, shown: str) -> None:
    macros = cast("Any", environment().get_template("_macros.html").module)
    assert macros.symbol(figure) == shown


def test_ids_are_links_by_the_name_that_the_page_knows() -> None:
    context = cast("Any", {"targets": [SimpleNamespace(id=TARGET, name="<Board> 9 x 6")]})
    assert linked(context, f"No {TARGET} & no {SESSION}.") == (
        f'No <a href="/ui/targets/{TARGET}"><bdi>&lt;Board&gt; 9 x 6</bdi></a> &amp; no '
        f'<a href="/ui/sessions/{SESSION}"><bdi>this session</bdi></a>.'
    )
    first, second = ("mea_" + digit * 26 for digit in "12")
    shown = linked(context, f"{first}, {second}, {first}")
    assert re.findall(r"<bdi>(.*?)</bdi>", shown) == ["image 1", "image 2", "image 1"]


@pytest.mark.parametrize(
    "advice", [FocalNotObservable.default_advice, "Or state the session's lens or its intrinsics."]
)
def test_the_advice_to_state_the_lens_leads_to_where_it_is_stated(advice: str) -> None:
    context: Any = {"session_id": SESSION, "may": lambda scope: True}
    shown = linked(context, on_pages(advice))
    assert shown.count(f'<a href="/ui/sessions/{SESSION}/change#lens">') == 1
    assert "intrinsics" not in shown
    for unable in ({}, context | {"may": lambda scope: False}):
        assert "<a" not in linked(cast("Any", unable), on_pages(advice))


def test_what_another_instrument_measured_is_not_mended_by_images() -> None:
    readings: Any = {"session_id": SESSION, "readings": 9, "counts": {"queued": 0}}
    assert next_page_here(readings, TooFewCycles.code) == ("?source=measured_poses", "To the readings")
    assert next_page_here(readings, "too_few_measurements") is None
    assert next_page_here(readings, CommandedPosesMissing.code) == ("/poses", "Load commanded poses")
    images: Any = {"session_id": SESSION, "readings": 9, "counts": {"queued": 1}}
    assert next_page_here(images, TooFewCycles.code) == ("", "To the images")
    chosen: Any = images | {"settings": {"source": "measured_poses"}}
    assert next_page_here(chosen, "too_few_measurements") is None
    assert next_page_here(cast("Any", {}), TooFewCycles.code) is None


def test_images_that_wait_lead_to_the_images() -> None:
    waiting = "None of the session's images is measured yet; 8 are waiting."
    assert next_page("too_few_measurements", waiting) == ("", "To the images")
    assert next_page("too_few_measurements", "The session has no images.") == ("/upload", "Add images")
    advice = "Ask again when the session's queued and running counts are lower."
    assert on_pages(advice) != advice


def test_a_refusal_leads_to_the_page_that_mends_it() -> None:
    assert next_page(CommandedPosesMissing.code) == ("/poses", "Load commanded poses")
    assert next_page(TooFewCycles.code) == ("", "To the images")
    assert next_page("nominal_robot_missing") == ("/change", "Choose the session's robot")
    assert next_page("not_converged", "No lens explains the points.") is None
    assert next_page("not_converged", "The frames cannot be tied.") == ("/poses", "See the commanded poses")


@pytest.mark.parametrize(
    ("reason", "link"),
    [
        ("The poses' commanded positions are not known.", ("/poses", "Load commanded poses")),
        ("Tying the frames needs at least 3 poses, got 2.", ("/upload", "Add images")),
        ("Robot and camera contradict each other.", ("/poses", "See the commanded poses")),
    ],
)
def test_accuracy_that_is_not_given_leads_to_what_its_reason_lacks(
    reason: str, link: tuple[str, str]
) -> None:
    assert next_page("accuracy_unavailable", f"Accuracy is not given: {reason}") == link


def test_no_sentence_of_the_numerics_has_names_of_the_api_on_pages() -> None:
    elsewhere = {"comparison", "simulation", "jit.py", "code_cache.py", "print_inspection.py"}
    sentences = {
        text
        for path in modules("core")
        if not elsewhere & set(path.parts)
        for text in texts_of(ast.parse(path.read_text(encoding="utf-8")))
        if text.count(" ") > 2 and re.search(r"[a-z…)]\.(?:$| )", text)
    }
    assert len(sentences) > 200
    assert not {said for text in sentences if TECHNICAL.search(said := on_pages(text)) or "(dh)" in said}


def test_names_that_users_gave_stay_in_sentences() -> None:
    assert on_pages("Pose home_left in img_0003.png moved.") == "Pose home_left in img_0003.png moved."


@pytest.mark.parametrize(("model", "last"), [("brown", "k3"), ("rational", "k6"), ("kannala_brandt", "k4")])
def test_radial_coefficients_are_named_by_their_lens_model(model: str, last: str) -> None:
    names = [f"k{k}" for k in range(1, int(last[1]) + 1)]
    meanings = [camera_meaning(name, model) for name in names]
    assert len(set(meanings)) == len(names)
    assert all(("θ" in one) is (model == "kannala_brandt") for one in meanings)
    assert camera_meaning("p1", model) == "tangential distortion"
