"""Texts of the API for a page's reader: its buttons in place of requests and commands, names in place of ids."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from jinja2 import pass_context
from jinja2.runtime import Context
from markupsafe import Markup, escape

from app.web.words import ESTIMATORS

_ID = re.compile(r"\b(mea|tgt|ses|rob|rep)_[0-9a-z]{26}\b")
_PAGES = {
    "mea": ("image", "/ui/measurements/"),
    "tgt": ("target", "/ui/targets/"),
    "ses": ("session", "/ui/sessions/"),
    "rob": ("robot", "/ui/robots/"),
    "rep": ("report", "/ui/reports/"),
}
_PHRASES = (
    ("PATCH the session with intrinsics, or choose another estimator", "Choose another estimator"),
    ("PUT the session's poses with what was commanded", "Load the commanded poses"),
    (
        "State the target's certificate or pitch_standard_uncertainty_mm",
        "State on the target's page what was measured",
    ),
    ("Name the target (target_id), or use", "Use"),
    (", or PATCH the session's robot_id", ", or change the session's robot"),
    ("omit source to use images", "choose “images” under Measured by"),
    ("; mend tags with `gridpose measurements correct`", "; a wrong tag is corrected on the page of images"),
    (
        ": `gridpose measurements correct`",
        ": on the page of images, select its images and choose Correct",
    ),
    ("(repeatability?estimator=per_image_fixed_pp)", "(estimator=per_image_fixed_pp)"),
    ("position_mm, roll_deg, pitch_deg and yaw_deg", "position, roll, pitch and yaw"),
    ("joint_angles_deg", "joint angles"),
    ("focus_group", "focus group"),
    ("target_ids", "target"),
    ("robot_id", "robot"),
    ("pose_id", "pose"),
)
"""Wording of the API, and what the same is called on the pages."""
_REQUESTS = re.compile(r" \([^()]*(?:`gridpose|\b(?:PATCH|POST|PUT|DELETE|GET)\b)[^()]*\)")
_ESTIMATOR = re.compile(r"\bestimator=(\w+)")
_NEXT = {
    "accuracy_unavailable": ("/poses", "Load commanded poses"),
    "commanded_poses_missing": ("/poses", "Load commanded poses"),
    "joint_angles_missing": ("/poses", "Load commanded poses"),
    "measured_poses_missing": ("/repeatability", "Use the images"),
    "mixed_image_sizes": ("", "To the images"),
    "too_few_cycles": ("", "To the images"),
    "no_usable_images": ("?state=failed", "See the refused images"),
    "too_few_measurements": ("/upload", "Add images"),
}
"""The session's page on which a refusal is mended, by code, and what the link to it says."""


def on_pages(text: str) -> str:
    """Return an advice in the words of the pages: without requests, commands, or names of fields."""
    for phrase, words in _PHRASES:
        text = text.replace(phrase, words)
    text = _REQUESTS.sub("", text)
    return _ESTIMATOR.sub(lambda match: _estimator(match[1]), text)


def next_page(code: str) -> tuple[str, str] | None:
    """Return the tail of the session's address where the refusal `code` is mended, and the link's text."""
    return _NEXT.get(code)


@pass_context
def linked(context: Context, text: str) -> Markup:
    """Return a sentence whose ids are links to their pages: by the name that the page knows, or by their kind."""
    names: Mapping[str, Any] = {one.id: one.name for one in context.get("targets") or ()}
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
    return Markup("").join([*parts, escape(text[end:])])


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
