#!/usr/bin/env python3
"""How long are the pages and their sentences? Then the sentences that are too long.

    python scripts/readability.py docs/planning.md  # none named: all that people wrote

Words are all words of a page; of prose are those outside of code, tables, headings and comments.
A formula or a name in backticks is one word, a link is its text. An item of a list ends a
sentence, as a full stop does.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LONGEST = 35
"""Words of a sentence; a longer one is read twice."""

_LEFT_OUT = re.compile(r"\A---\n.*?^---$|^```.*?^```$|<!--.*?-->", re.MULTILINE | re.DOTALL)
_ITEM = re.compile(r"^ *(?:[*+-]|\d+\.) +", re.MULTILINE)
_CODE = re.compile(r"``.+?``|`[^`]+`", re.DOTALL)
_LINK = re.compile(r"!?\[((?:[^\[\]]|\[[^\]]*\])*)\]\([^)]*\)", re.DOTALL)
_ABBREVIATION = re.compile(r"\b(e\.g|i\.e|Eqs?|Figs?|Sec|vs|cf|al)\.")
_END = re.compile(r"""(?<=[.!?])["')*_]*\s+(?=["'(*_]*[A-Z0-9])""")
_WORD = re.compile(r"[^\W_]")


def pages() -> list[Path]:
    """Return the pages of the site that people wrote."""
    return sorted((ROOT / "docs").rglob("*.md"))


def sentences(text: str) -> list[str]:
    """Return the sentences of a page in Markdown, each in one line."""
    text = _ITEM.sub("\n\n", _LEFT_OUT.sub("", text))
    return [
        sentence
        for block in re.split(r"\n\s*\n", text)
        if not block.lstrip("\n").startswith(("    ", "|", "#"))
        for sentence in _END.split(_plain(block))
        if words(sentence)
    ]


def words(sentence: str) -> int:
    """Return how many words a sentence has; signs that stand alone are none."""
    return sum(bool(_WORD.search(word)) for word in sentence.split())


def _plain(block: str) -> str:
    text = _LINK.sub(r"\1", _CODE.sub("Code", block))
    return " ".join(_ABBREVIATION.sub(r"\1", text).split())


def main() -> int:
    """Print a line for each page and the sentences that are too long; 1 where there are some."""
    found = {page: sentences(page.read_text("utf-8")) for page in _chosen()}
    print(f"{'page':<24}{'words':>8}{'of prose':>10}{'sentences':>11}{'mean':>6}{'too long':>10}")
    for page, texts in found.items():
        print(_line(page.name, len(page.read_text("utf-8").split()), texts))
    everything = sum(len(page.read_text("utf-8").split()) for page in found)
    print(_line("all", everything, [text for texts in found.values() for text in texts]))
    long = [(p, text) for p, texts in found.items() for text in texts if words(text) > LONGEST]
    for page, text in long:
        print(f"\n{page.name}, {words(text)} words: {text}")
    return bool(long)


def _line(name: str, everything: int, texts: list[str]) -> str:
    lengths = [words(text) for text in texts]
    mean = sum(lengths) / max(len(lengths), 1)
    many = sum(length > LONGEST for length in lengths)
    return f"{name:<24}{everything:>8}{sum(lengths):>10}{len(texts):>11}{mean:>6.1f}{many:>10}"


def _chosen() -> list[Path]:
    return [Path(name) for name in sys.argv[1:]] or pages()


if __name__ == "__main__":
    sys.exit(main())
