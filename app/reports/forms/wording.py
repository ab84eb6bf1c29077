"""What the service's texts are called in a report, which is read by people who know no ids, fields or settings.

Warnings, reasons and refusals name things as the API does, for programs and for whoever asks them. `worded` gives the
document in which they read as a report does, and every form for people is drawn from it; the forms JSON and CSV keep
the API's words. It works by what a word is, not by message:

    an id                        the name that the report's inputs give it: of an image its file, pose and cycle
    a request or a command       removed with its parentheses; a method of HTTP outside of them is a verb
    name=value                   the setting in words
    a field                      its name in words, without its unit
    a code                       its words
    what a user named            stays as it is
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

Json = Mapping[str, Any]

SENTENCES = frozenset({"advice", "detail", "gain", "reason", "sentence"})
"""Fields of analyses and refusals that hold sentences."""
_NAMES = {
    "asymmetric_circles": "asymmetric circles",
    "aprilgrid": "AprilGrid",
    "brown": "Brown-Conrady",
    "charuco": "ChArUco board",
    "classic_dh": "Denavit-Hartenberg, classic",
    "cpa": "circle-point analysis",
    "dh": "Denavit-Hartenberg",
    "dh_and_compliance": "Denavit-Hartenberg and compliance",
    "given": "given camera",
    "kannala_brandt": "Kannala-Brandt",
    "per_image": "each image alone",
    "per_image_fixed_pp": "each image alone, principal point held",
    "per_image_session_prior": "each image alone, with the session's lens",
    "pooled_free_focal": "pooled, free focal length",
}
"""Codes whose words are not those of their letters."""
_FIELDS = {
    "corrected": "corrected figures",
    "including_degraded": "the table with degraded images",
    "lens_model": "the choice of a lens model",
    "marker_mm": "the size of a marker",
    "pitch_mm": "the pitch",
    "pitch_standard_uncertainty_mm": "the standard uncertainty of its pitch",
    "rp_ratio": "ratio of the scatter to what is predicted",
    "without_outliers": "the table without the outliers",
}
_ESTIMATORS = frozenset(
    {"pooled", "given", *(name for name in _NAMES if name.startswith(("per_", "pooled_")))}
)
_METHODS = {"DELETE": "delete", "GET": "ask for", "PATCH": "change", "POST": "send", "PUT": "state"}
_KINDS = {"mea": "an image", "mpo": "a reading", "rob": "the robot", "ses": "the session", "tgt": "a target"}
_UNIT = re.compile(r"_(?:mm|deg|px|um|kg|percent|min|c|h|s|id)$")
_REQUEST = re.compile(r" ?\([^()]*(?:`gridpose|\bgridpose [a-z]|\b(?:DELETE|GET|PATCH|POST|PUT)\b)[^()]*\)")
_LETTERS = {"alpha": "α", "beta": "β", "theta": "θ"}
_PARAMETER = re.compile(r"\b(alpha|beta|theta)(\d+)(?: offset)?\b")
_TECHNICAL = (
    r"(?P<id>\b[a-z]{3}_[0-9a-hjkmnp-tv-z]{26}\b)"
    r"|(?P<setting>\b[a-z_]+)=(?P<value>[A-Za-z0-9_]+)"
    r"|(?P<field>\b[a-z][a-z0-9]*(?:_[a-z0-9]+)+\b)"
    r"|\b(?P<method>DELETE|GET|PATCH|POST|PUT)\b"
    r"|(?P<mark>`)"
)


def words(code: str) -> str:
    """Return a code as words: `below_detection` as "below detection"."""
    return _NAMES.get(code, code.replace("_", " "))


def symbols(text: str) -> str:
    """Return a text with a robot's parameters as tables have them: `theta1 offset` as "θ1", `alpha6` as "α6"."""
    return _PARAMETER.sub(lambda match: f"{_LETTERS[match[1]]}{match[2]}", text)


def worded(document: Json) -> dict[str, Any]:
    """Return a report's document with its texts in the words of a report; `named` is the name of what has an id."""
    wording = Wording.of(document["inputs"])
    return {**document, **{part: wording.of_part(document[part]) for part in ("analyses", "refusals")}}


@dataclass(frozen=True, slots=True)
class Wording:
    """The names of a report's inputs by their ids, and how its texts are read."""

    names: Mapping[str, str]
    technical: re.Pattern[str]

    @classmethod
    def of(cls, inputs: Json) -> Wording:
        """Return the wording of a report on these inputs."""
        owners = [inputs["session"], *([inputs["robot"]] if inputs["robot"] is not None else [])]
        names = {one["id"]: one["name"] for one in (*owners, *inputs["targets"])}
        for one in (*inputs["images"], *inputs["measured_poses"]):
            names[one["measurement_id"]] = measurement_name(one)
        own = {*names.values(), *(one["pose_id"] for one in inputs["poses"])}
        for one in (*inputs["images"], *inputs["measured_poses"]):
            own |= {str(one[key]) for key in ("pose_id", "filename", "focus_group") if one.get(key)}
        return cls(names, re.compile(_own(own) + _TECHNICAL))

    def of_part(self, value: Any, key: str = "") -> Any:
        """Return a part of a document with its texts in words, and a `named` wherever it has an id."""
        if isinstance(value, Mapping):
            found = {name: self.of_part(item, name) for name, item in value.items()}
            id_ = value.get("measurement_id") or value.get("measured_pose_id") or value.get("target_id")
            return {**found, "named": self._name(id_)} if isinstance(id_, str) else found
        if isinstance(value, list):
            return [self.of_part(item, key) for item in value]
        return self.text(value) if key in SENTENCES and isinstance(value, str) else value

    def text(self, text: str) -> str:
        """Return a text in the words of a report."""
        text = _REQUEST.sub("", text)
        return self.technical.sub(lambda match: self._said(match, text), text)

    def _said(self, match: re.Match[str], text: str) -> str:
        found = match.groupdict()
        if found["id"] is not None:
            return self._name(found["id"])
        if found["setting"] is not None:
            return _setting(found["setting"], found["value"])
        if found["field"] is not None:
            return _field(found["field"])
        if found["method"] is not None:
            verb = _METHODS[found["method"]]
            begins = match.start() == 0 or text[: match.start()].rstrip().endswith((".", ":"))
            return verb.capitalize() if begins else verb
        return "" if found["mark"] is not None else match[0]

    def _name(self, id_: str) -> str:
        return self.names.get(id_) or _KINDS.get(id_[:3], id_)


def measurement_name(one: Json) -> str:
    """Return what an image or a reading is called: its file, pose and cycle; without the former two by its hash."""
    cycle = "" if one["cycle"] is None else f"cycle {one['cycle']}"
    if one.get("filename"):
        return f"{one['filename']} ({', '.join(filter(None, (one['pose_id'], cycle)))})"
    return f"{one['pose_id']} ({cycle or 'SHA-256 ' + _hash(one)[:8]})"


def _hash(one: Json) -> str:
    return str(one.get("sha256") or one["content_sha256"])


def _setting(name: str, value: str) -> str:
    if name == "estimator":
        return f"the estimator “{words(value)}”"
    if value in ("true", "false"):
        return f"{'with' if value == 'true' else 'without'} “{_plain(name)}”"
    return f"the {_plain(name)} “{words(value)}”"


def _field(name: str) -> str:
    if name in _ESTIMATORS:
        return f"“{words(name)}”"
    return _FIELDS.get(name) or _NAMES.get(name) or _plain(name)


def _plain(name: str) -> str:
    return _UNIT.sub("", re.sub(r"_ids$", "s", name)).replace("_", " ")


def _own(names: Iterable[str]) -> str:
    """Return the pattern of those names of the user's that could be read as the service's, and "" without any."""
    could = sorted((name for name in names if re.search(_TECHNICAL, name)), key=len, reverse=True)
    return "".join(rf"(?<!\w){re.escape(name)}(?!\w)|" for name in could)


def reading_id(found: Mapping[str, Any]) -> str | None:
    """Return the id of an image or of a measured pose; reports of early versions have the latter's under the former's
    name.
    """
    name: str | None = found["measurement_id"] or found.get("measured_pose_id")
    return name
