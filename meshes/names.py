"""Names that fit on one line of a table, a log and a message."""

from __future__ import annotations

import unicodedata

# Categories of characters that break lines or are no text: controls, separators of lines and paragraphs, surrogates.
_BREAKING = ("Cc", "Zl", "Zp", "Cs")


def breaking_character(text: str) -> str | None:
    """The first character that breaks a line or is no text, as `U+2028`; None where there is none."""
    if text.isascii() and text.isprintable():
        return None
    for character in text:
        if unicodedata.category(character) in _BREAKING:
            return f"U+{ord(character):04X}"
    return None
