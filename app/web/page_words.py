"""Texts of the API for a page's reader: its buttons in place of requests and commands, names in place of ids."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from jinja2 import pass_context
from jinja2.runtime import Context
from markupsafe import Markup, escape

from app.web.words import ESTIMATORS

STATE_LENS = "state the session's lens"
"""In an advice, what the page of the session's changes takes."""
MISSING = "Check the id; lists show what exists."
"""What the API advises where there is no such thing."""
_ID = re.compile(r"\b(mea|tgt|ses|rob|rep)_[0-9a-z]{26}\b")
_PAGES = {
    "mea": ("image", "/ui/measurements/"),
    "tgt": ("target", "/ui/targets/"),
    "ses": ("session", "/ui/sessions/"),
    "rob": ("robot", "/ui/robots/"),
    "rep": ("report", "/ui/reports/"),
}
_PHRASES = (
    (f"{STATE_LENS} (focal length and pixel pitch) or its intrinsics", STATE_LENS),
    (f"{STATE_LENS} or its intrinsics", STATE_LENS),
    (
        "Ask again when the session's queued and running counts are lower.",
        "Load this page again when they are computed: the page of images shows how far they are.",
    ),
    ("PATCH the session with intrinsics, or choose another estimator", "Choose another estimator"),
    ("PUT the session's poses with what was commanded", "Load the commanded poses"),
    (
        "State the target's certificate or pitch_standard_uncertainty_mm",
        "State on the target's page what was measured",
    ),
    ("Name the target (target_id), or use", "Use"),
    ("set the session's camera_mount to fixed", "change the session's camera to fixed"),
    ("set the session's camera_mount to robot", "change the session's camera to the one on the robot"),
    (", or PATCH the session's robot_id", ", or change the session's robot"),
    ("omit source to use images", "choose “images” under Measured by"),
    ("; mend tags with `gridpose measurements correct`", "; a wrong tag is corrected on the page of images"),
    (
        ": `gridpose measurements correct`",
        ": on the page of images, select its images and choose Correct",
    ),
    (
        "state burst 1, 2, ... with them.",
        "give them one cycle, and number them 1, 2, ... as images of the stop: on the page of images, select each "
        "and choose Correct.",
    ),
    ("the same cycle and a burst index each.", "the same cycle and a number each, as images of the stop."),
    (
        "or give the session intrinsics and use estimator=given.",
        "or give the session this camera's intrinsics by the command line (“sessions change”; no page does), and "
        "choose the estimator “Given camera” then.",
    ),
    ("(repeatability?estimator=per_image_fixed_pp)", "(estimator=per_image_fixed_pp)"),
    ("This address needs an API key.", "You are signed out."),
    ("Send it as `Authorization: Bearer KEY`.", "Sign in again."),
    (" Programs send their key as `Authorization: Bearer KEY`.", ""),
    ("The request does not carry the token of the page that it comes from.", "The page is out of date."),
    ("Use a key made with the scope", "Sign in with a key of scope"),
    ("Use a key that is not limited", "Sign in with a key that is not limited"),
    ("bytes_per_day of the key", "the key's quota"),
    ("nothing was kept of this request, so send it again.", "nothing was stored: do this again afterwards."),
    (", as measurement ", ", as "),
    ("no such measurement", "no such image"),
    (MISSING, "It was deleted: load the page again."),
    ("; without_outliers has the figures of the others", "; the table has RP_l without them, too"),
    ("; including_degraded has the figures with them", "; reports have the figures with them"),
    (
        "; lens_model=brown shows the figures with Brown's model",
        "; the camera's page compares it with Brown's model",
    ),
    ("identify it (dh)", "identify it on the robot's page"),
    ("identify the robot (dh)", "identify the robot on its page"),
    (" (`subtract_witness=true`)", ""),
    (" (`error_model`)", ""),
    (", or leave lens_model out", ""),
    ("Leave lens_model out, and use", "Use"),
    (" with lens_model.", " with the lens model."),
    ("Ask for method=global.", "Take the global method."),
    ("the global fit with model=auto", "the global fit"),
    ("Take method=global with model=auto,", "Take the global method with all terms,"),
    ("source=measured_poses (--source measured_poses)", "“another instrument” under Measured by"),
    (
        "PUT each direction of approach as a pose of its own,",
        "Make each direction of approach a pose of its own,",
    ),
    ("The estimator `given`", "The estimator “Given camera”"),
    ("Make the target first; every id in target_ids must exist.", "Choose another: it was deleted."),
    ("Make the robot first, or leave robot_id away.", "Choose another: it was deleted."),
    ("Use OpenCV's name, for example DICT_6X6_250.", "Choose one."),
    (
        "State pitch_x_mm, pitch_y_mm and standard_uncertainty, or points_mm and points_standard_uncertainty_mm.",
        "State both pitches and the standard uncertainty of each.",
    ),
    (
        "Give the points row by row in the target frame, origin at grid point (0, 0), x along columns, in mm.",
        "Check the pitches: they are in mm, from one grid point to the next.",
    ),
    (
        "send them with accept_implausible=true (--accept-implausible).",
        "tick the box that says so, and store them.",
    ),
    ("(PATCH `excluded`, `gridpose measurements exclude`)", "on its page"),
    (
        "delete it (DELETE, `gridpose measurements delete`, with a key of scope admin)",
        "have an administrator delete it",
    ),
)
"""Wording of the API, and what the same is called on the pages."""
_WHOLE = {
    "The request's content is not valid.": "Some fields are missing or not valid.",
    "Correct the fields listed in errors.": "Correct the fields that are named, and send the form again.",
    "is required": "must be filled in",
    "must have at least 1 character": "must be filled in",
    "must have at least 1 item": "needs one at least",
}
"""Texts that are replaced where they stand alone, of one field or of any."""
_FIELDS = {
    "a_mm": "a",
    "alpha_deg": "α",
    "body": "what was sent",
    "d_mm": "d",
    "expires_in_days": "days until it ends",
    "pose_id": "pose",
    "position_mm": "position",
    "robot_id": "robot",
    "session_id": "session",
    "signatories": "signers",
    "target_id": "target",
    "target_ids": "target",
    "theta_offset_deg": "θ offset",
}
"""Fields of the API whose words on the pages are not those of their names."""
_UNIT = re.compile(r"_(mm|deg|c|kg|percent|min|um|px|mrad)$")
_FIELD_NAMES = re.compile(
    r"\b(position|roll|pitch|yaw|marker|joint_angles|focus_group|standard_uncertainty|pitch_[xy]|"
    r"(?:pose|robot|session|target)_ids?|points)(_mm|_deg)?\b"
)
_IN_SENTENCES = {
    "T_base_target": "the target in the base",
    "T_flange_camera": "the camera on the flange",
    "a_mm": "a",
    "d_mm": "d",
    "focal_length_mm": "the focal length",
    "joint_coupling": "the coupling of its joints",
    "legacy_layout": "the layout of early OpenCV",
    "lens_model": "the lens model",
    "pitch_standard_uncertainty_mm": "the standard uncertainty of the pitch",
    "pixel_pitch_um": "the pixel pitch",
    "print_kind": "the kind of print",
    "random_poses": "random poses",
    "rp_ratio": "ratio of scatter to prediction",
    "sweep_half_angle_deg": "the sweeps",
    "shape_standard_uncertainty": "the standard uncertainty of the print's shape",
}
"""Names of the API that sentences of analyses have. Others are left: a user's pose or file may be called so."""
_SENTENCE_NAMES = re.compile(rf"\b(?:{'|'.join(_IN_SENTENCES)})\b")
_GUESS = re.compile(r"^(Values look like \w+): .*")
_REQUESTS = re.compile(r" \([^()]*(?:`gridpose|\b(?:PATCH|POST|PUT|DELETE|GET)\b)[^()]*\)")
_COUNTED_CODES = re.compile(r"\b[a-z]+(?:_[a-z]+)+(?= \(\d+\))")
_ESTIMATOR = re.compile(r"\bestimator=(\w+)")
_NEXT = (
    ("accuracy_unavailable", "are not known", "/poses", "Load commanded poses"),
    ("accuracy_unavailable", "poses, got", "/upload", "Add images"),
    ("accuracy_unavailable", "", "/poses", "See the commanded poses"),
    ("approach_variation_unavailable", "", "/poses", "Load commanded poses"),
    ("commanded_poses_missing", "", "/poses", "Load commanded poses"),
    ("cycles_repeated", "", "", "To the images"),
    ("focal_not_observable", "Together", "/upload", "Add images"),
    ("joint_angles_missing", "", "/poses", "Load commanded poses"),
    ("lens_beyond_brown", "", "/camera", "See the camera"),
    ("measured_poses_missing", "", "/repeatability", "Use the images"),
    ("mixed_image_sizes", "", "", "To the images"),
    ("no_usable_images", "", "?state=failed", "See the refused images"),
    ("nominal_robot_missing", "", "/change", "Choose the session's robot"),
    ("not_converged", "poses", "/poses", "See the commanded poses"),
    ("not_converged", "frames", "/poses", "See the commanded poses"),
    ("print_scale_mismatch", "", "/robot", "See the robot"),
    ("too_few_cycles", "", "", "To the images"),
    ("too_few_measurements", "waiting", "", "To the images"),
    ("too_few_measurements", "", "/upload", "Add images"),
)
"""By code, and what the text says, the tail of the address of the session's page on which a refusal is mended, and what
the link to it says; the first that fits.
"""
_LISTS = {
    "report": ("/ui/reports", "All reports"),
    "robot": ("/ui/robots", "All robots"),
    "target": ("/ui/targets", "All targets"),
}


def on_pages(text: str, field: str = "") -> str:
    """Return a text in the words of the pages: without requests, commands, or names of fields; one said of `field`."""
    text = _WHOLE.get(f"{field.rpartition('.')[2]} {text}") or _WHOLE.get(text, text)
    for phrase, words in _PHRASES:
        text = text.replace(phrase, words)
    text = _REQUESTS.sub("", _GUESS.sub(r"\1.", text))
    text = _SENTENCE_NAMES.sub(lambda match: _IN_SENTENCES[match[0]], text)
    text = _FIELD_NAMES.sub(lambda match: named(match[0]), text)
    text = _COUNTED_CODES.sub(lambda match: match[0].replace("_", " "), text)
    return _ESTIMATOR.sub(lambda match: _estimator(match[1]), text)


def named(field: str) -> str:
    """Return what pages call a field of the API: `joints.0.a_mm` is "joint 1, a"; `3.pose_id` is "pose"."""
    names: list[str] = []
    for part in field.split("."):
        if not part.isdecimal():
            names.append(_FIELDS.get(part) or _UNIT.sub("", part).replace("_", " "))
        elif names:
            names[-1] = f"{names[-1].removesuffix('s')} {int(part) + 1}"
    return ", ".join(names)


def next_page(code: str, detail: str = "") -> tuple[str, str] | None:
    """Return the tail of the session's address where the refusal `code` is mended, and the link's text."""
    for of_code, said, tail, text in _NEXT:
        if of_code == code and said in detail:
            return tail, text
    return None


@pass_context
def next_page_here(context: Context, code: str, detail: str = "") -> tuple[str, str] | None:
    """Return the same on a page of a session; where another instrument measured, images are no answer."""
    found = next_page(code, detail) if context.get("session_id") is not None else None
    if found is None or not _of_readings(context):
        return found
    return {"": ("?source=measured_poses", "To the readings"), "/upload": None, "?state=failed": None}.get(
        found[0], found
    )


def _of_readings(context: Context) -> bool:
    source = context.get("source") or (context.get("settings") or {}).get("source")
    return source == "measured_poses" or bool(context.get("readings") and not any(context["counts"].values()))


def list_of(code: str) -> tuple[str, str]:
    """Return the address of the list in which what is missing would be, by the refusal's code, and the link's text."""
    return _LISTS.get(code.removesuffix("_not_found"), ("/ui/", "All sessions"))


@pass_context
def linked(context: Context, text: str) -> Markup:
    """Return a sentence whose ids are links to their pages: by the name that the page knows (`targets` and
    `image_names`), or by their kind. Where it says so, it leads to where the session's lens is stated.
    """
    names: Mapping[str, Any] = {
        **{one.id: one.name for one in context.get("targets") or ()},
        **(context.get("image_names") or {}),
    }
    parts: list[Markup] = []
    numbers: dict[str, int] = {}
    end = 0
    for match in _ID.finditer(text):
        kind, address = _PAGES[match[1]]
        if match[0] in names:
            name = names[match[0]]
        elif kind == "image":
            name = f"image {numbers.setdefault(match[0], len(numbers) + 1)}"
        else:
            name = f"this {kind}"
        parts += [
            escape(text[end : match.start()]),
            Markup('<a href="{}{}"><bdi>{}</bdi></a>').format(address, match[0], name),
        ]
        end = match.end()
    whole = Markup("").join([*parts, escape(text[end:])])
    session_id, may = context.get("session_id"), context.get("may")
    if session_id is None or may is None or not may("upload"):
        return whole
    link = Markup('<a href="/ui/sessions/{}/change#lens">{}</a>').format(session_id, STATE_LENS)
    return whole.replace(escape(STATE_LENS), link)


def coded(text: str) -> Markup:
    """Return a sentence whose `commands`, between backticks, are set as code."""
    parts = text.split("`")
    if len(parts) % 2 == 0:  # a backtick that nothing closes
        return escape(text)
    return Markup("").join(
        Markup("<code>{}</code>").format(part) if place % 2 else escape(part)
        for place, part in enumerate(parts)
    )


def _estimator(name: str) -> str:
    return f"the estimator “{ESTIMATORS[name][0]}”" if name in ESTIMATORS else f"the estimator {name}"
