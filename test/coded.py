"""Codes of warnings and reasons, by which tests know them however they are worded."""

from rotcal_ros.foundation.language import Phrase


def coded(*texts):
    """Return by code the arguments of every text, and of what stands in their places."""
    found = {}
    for text in texts:
        assert isinstance(text, Phrase), text
        found.setdefault(text.template, []).append(text.parts)
        inside = coded(*(part for part in text.parts if isinstance(part, Phrase)))
        for code, arguments in inside.items():
            found.setdefault(code, []).extend(arguments)
    return found
