"""Letters that no font has, and which texts of a report hold them, in the words of its reader."""

from __future__ import annotations

import re
from collections.abc import Iterator

from app.reports.forms.wording import Json

FONTS_OF_COMPUTERS = (
    *("DejaVu Sans Mono", "New Computer Modern", "New Computer Modern Math"),  # the PDF's own
    *("Noto Sans CJK SC", "Noto Sans SC", "Source Han Sans SC", "WenQuanYi Zen Hei", "WenQuanYi Micro Hei"),
    *("Microsoft YaHei", "SimSun", "PingFang SC"),
    *(
        "Noto Sans CJK JP",
        "Noto Sans JP",
        "Yu Gothic",
        "MS Gothic",
        "Hiragino Sans",
        "IPAGothic",
        "TakaoGothic",
    ),
    *("Noto Sans CJK KR", "Noto Sans KR", "Malgun Gothic", "Apple SD Gothic Neo", "NanumGothic"),
    *("Noto Sans Thai", "Leelawadee UI", "Tahoma", "Thonburi", "Garuda", "Loma"),
    *("Noto Color Emoji", "Segoe UI Emoji", "Apple Color Emoji"),
)
"""Families of Debian, Windows and macOS that draw the letters they say they have, in the order they are tried."""
_NAMED = re.compile(r'(?:the text|the codepoint) `"(\\u\{[0-9a-f]+\}|[^`]+)"`')
_ESCAPED = re.compile(r"\\u\{([0-9a-f]+)\}")
_MAX_LETTERS = 8
_MAX_TEXTS = 5


def missing_letters(diagnostic: str) -> list[str]:
    """Return the letters that the compiler's message names as those that no font has; none of another message."""
    found = (_ESCAPED.sub(lambda match: chr(int(match[1], 16)), one) for one in _NAMED.findall(diagnostic))
    return list(dict.fromkeys(found))


def missing_in_words(document: Json, letters: list[str]) -> str:
    """Return which letters are missing, and which texts of the report hold them."""
    holding = [
        f"{what} “{text}”"
        for what, text in dict.fromkeys(_texts(document))
        if any(letter in text for letter in letters)
    ]
    named = ", ".join(
        f"“{one}”" if one.isprintable() else f"U+{ord(one[0]):04X}" for one in letters[:_MAX_LETTERS]
    )
    more = " and more" if len(letters) > _MAX_LETTERS else ""
    held = "; ".join(holding[:_MAX_TEXTS]) or "one of its texts"
    others = f"; and {len(holding) - _MAX_TEXTS} more" if len(holding) > _MAX_TEXTS else ""
    return f"no font of the service's computer has {named}{more}, in {held}{others}."


def _texts(document: Json) -> Iterator[tuple[str, str]]:
    """Yield every text of a user that the PDF may show, with what it is."""
    inputs, subject, template = document["inputs"], document["subject"], document["template"]
    robot, conditions, maker = inputs["robot"] or {}, subject["conditions"] or {}, document["made_by"] or {}
    session = subject["session"]["name"]
    found = [
        ("the session's name", session),
        ("the report's title", document["title"].replace(session, "")),
        *((f"a signer's {key}", one[key]) for one in document["signatories"] for key in ("name", "role")),
        ("the name of the key", maker.get("name")),
        *((f"the robot's {key.replace('_', ' ')}", robot.get(key)) for key in _ROBOT),
        *((f"the session's {key}", conditions.get(key)) for key in ("operator", "notes")),
        *(("a target's name", one["name"]) for one in inputs["targets"]),
        *(
            ("a target's certificate", text)
            for one in inputs["targets"]
            for text in _strings(one["certificate"])
        ),
        *((words, one.get(key)) for one in inputs["images"] for key, words in _IMAGE.items()),
        *((words, one.get(key)) for one in inputs["measured_poses"] for key, words in _IMAGE.items()),
        *(("templates/report.toml", text) for text in _strings(template)),
    ]
    yield from ((what, text) for what, text in found if text)


_ROBOT = ("name", "manufacturer", "model", "serial_number")
_IMAGE = {"pose_id": "a pose", "focus_group": "a focus group", "filename": "an image's file name"}


def _strings(value: object) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for name, item in value.items():
            yield name
            yield from _strings(item)
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _strings(item)
