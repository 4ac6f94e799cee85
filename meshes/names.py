"""Names that fit on one line of a table, a log and a message, and are no formula of a spreadsheet."""

from __future__ import annotations

import unicodedata

# Categories of characters that break lines or are no text: controls, separators of lines and paragraphs, surrogates.
_BREAKING = ("Cc", "Zl", "Zp", "Cs")
# Directions of writing that turn round what follows on the line.
_TURNING = ("LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI")
_FORMULA = ("=", "+", "-", "@")


def breaking_character(text: str) -> str | None:
    """The first character that breaks or turns a line or is no text, as `U+2028`; None where there is none."""
    if text.isascii() and text.isprintable():
        return None
    for character in text:
        if unicodedata.category(character) in _BREAKING or unicodedata.bidirectional(character) in _TURNING:
            return f"U+{ord(character):04X}"
    return None


def is_formula(text: str) -> bool:
    """Whether a spreadsheet would take a cell that begins with this text for a formula, and run it."""
    return text.startswith(_FORMULA)
