"""Names from outside, as pictures and pages can show them."""

import unicodedata


def printable(text: str) -> str:
    """A text without what XML and UTF-8 cannot hold: control characters, and bytes of a file's
    name that are no text."""
    return "".join(
        c if c in "\n\t" or unicodedata.category(c) not in ("Cc", "Cs", "Cn") else "\ufffd"
        for c in text
    )
