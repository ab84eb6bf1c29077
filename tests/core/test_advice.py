"""Advice on one matter is the same wherever it is given."""

from __future__ import annotations

import ast
import re

from core.errors import ADVISED_TILT, FocalNotObservable
from tests.support.source_texts import PROJECT, modules, texts_of

_OF_SHAPE = "20° to 40°"
"""What determines a print's shape is another matter than the focal length: views from all sides."""
_ADVISES = re.compile(
    r"(?:^|[.;] )(?=[^.]*\b[Tt]ilt)(?:Add|Bring|Fill|Give|Show|Take|Tilt|Turn|Use)\b[^.]*?(\d+(?:°|-\d+°)[^.,;]*)"
)


def test_the_tilt_that_is_advised_is_one() -> None:
    said = {
        (path.relative_to(PROJECT).as_posix(), match[1])
        for path in modules("core", "app")
        for text in texts_of(ast.parse(path.read_text(encoding="utf-8")))
        for match in _ADVISES.finditer(text)
    }
    assert said, "the advice on shape is found"
    assert not {one for one in said if not one[1].startswith((ADVISED_TILT, _OF_SHAPE))}


def test_a_focal_length_that_no_view_determines_has_a_next_step() -> None:
    advice = FocalNotObservable.default_advice or ""
    for step in (ADVISED_TILT, "focal length and pixel pitch", "`lens`", "`gridpose sessions change --file`"):
        assert step in advice
