"""Text of users in XML, HTML and CSV: escaped, and without the characters that these cannot hold.

Reference: W3C, "Extensible Markup Language (XML) 1.0 (Fifth Edition)", 2008, production 2 (Char) and section 2.5.
"""

from __future__ import annotations

import re
from xml.sax.saxutils import escape, quoteattr

_ILLEGAL = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_REPLACEMENT = "\ufffd"
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def legal_text(text: str) -> str:
    """Return the text with U+FFFD for each control character, surrogate and noncharacter that XML cannot hold."""
    return _ILLEGAL.sub(_REPLACEMENT, text)


def element_text(text: str) -> str:
    """Return the text as it stands between tags."""
    return escape(legal_text(text))


def quoted_attribute(text: str) -> str:
    """Return the text as an attribute's value, within quotes."""
    return quoteattr(legal_text(text))


def comment_text(text: str) -> str:
    """Return the text as it stands within a comment, where two hyphens end it."""
    return re.sub("-(?=-|$)", "- ", element_text(text))


def guarded(text: str) -> str:
    """Return the text as a cell of a table that no spreadsheet takes for a formula."""
    return f"'{text}" if text.startswith(_FORMULA) else text
