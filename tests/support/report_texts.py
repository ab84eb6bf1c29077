"""What a reader sees of a report's forms, and what does not belong in it: ids, settings, fields, requests."""

from __future__ import annotations

import html
import re
from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree

TECHNICAL = re.compile(
    r"\b[a-z]{3}_[0-9a-z]{26}\b"  # an id
    r"|\w=\w"  # a setting
    r"|\b[a-z][a-z0-9]*(?:_[a-z0-9]+)+\b"  # a field or a code
    r"|/v1/|\.\.\./|\b(?:DELETE|GET|PATCH|POST|PUT)\b|`"  # a request
)
_DCC = "{https://ptb.de/dcc}"
_HIDDEN = re.compile(r"<style>.*?</style>|<img [^>]*>|<[^>]+>", re.DOTALL)


def page_text(page: bytes) -> str:
    """The words of the form HTML."""
    return " ".join(html.unescape(_HIDDEN.sub(" ", page.decode())).split())


def certificate_text(certificate: bytes) -> str:
    """The words of the results in the form XML; ids of items and references stand elsewhere in it."""
    results = ElementTree.fromstring(certificate).find(f"{_DCC}measurementResults")
    assert results is not None
    return " ".join(one.text or "" for one in results.iter(f"{_DCC}content"))


def technical_words(forms: Mapping[str, bytes], document: Mapping[str, Any]) -> list[str]:
    """What a report says that its reader does not know; its own id is the document's number, names are the user's."""
    texts = page_text(forms["html"])
    if "xml" in forms:
        texts += " " + certificate_text(forms["xml"])
    own = {document["report_id"], document["subject"]["session"]["name"]}
    for one in (*document["inputs"]["images"], *document["inputs"]["measured_poses"]):
        own |= {one["pose_id"], one.get("filename") or "", one.get("focus_group") or ""}
    for name in sorted(own - {""}, key=len, reverse=True):
        texts = texts.replace(name, "…")
    return [texts[max(0, m.start() - 60) : m.end() + 30] for m in TECHNICAL.finditer(texts)]
