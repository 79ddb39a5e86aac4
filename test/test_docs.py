"""The pages: links lead somewhere, lines fit any editor, no sentence has to be read twice."""

import re
import runpy
from itertools import chain
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    path
    for pattern in ("README.md", "CONTRIBUTING.md", "docs/**/*.md")
    for path in ROOT.glob(pattern)
)
MAX_WIDTH = 120
MAX_WORDS = 35
SITE = runpy.run_path(str(ROOT / "scripts" / "docs_site.py"))
MADE = SITE["MADE"]
READABILITY = runpy.run_path(str(ROOT / "scripts" / "readability.py"))
each_page = pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))


def prose(page: Path) -> list[str]:
    """Return the lines outside of code, both fenced and indented (below a blank line)."""
    lines = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.M | re.S).splitlines()
    blocks = re.split(r"\n\s*\n", "\n".join(lines))
    return list(chain.from_iterable(b.splitlines() for b in blocks if not b.startswith("    ")))


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as code hosts make them."""
    titles = [match[1] for line in prose(page) if (match := re.match(r"#+ (.+)", line))]
    return {re.sub(r"[^\w\- ]", "", title).lower().replace(" ", "-") for title in titles}


@each_page
def test_every_link_leads_somewhere(page):
    links = re.findall(r"\]\(([^)\s#]*)(?:#([^)]+))?\)", "\n".join(prose(page)))
    local = [
        (page.parent / file if file else page, anchor)
        for file, anchor in links
        if "://" not in file and not (page.parent.name == "docs" and file in MADE)
    ]
    assert [file for file, _anchor in local if not file.exists()] == []
    assert [(f, a) for f, a in local if a and a not in anchors(f)] == []


def test_each_table_of_figures_is_shown_by_a_page():
    """A link alone on its line; the site shows the table below it, a code host behind it."""
    shown = [
        (page.parent / link["path"]).resolve()
        for page in PAGES
        for link in SITE["TABLE"].finditer(page.read_text())
    ]
    kept = chain.from_iterable(
        (ROOT / "research" / folder).glob("*.csv") for folder in ("figures", "yardstick")
    )
    assert sorted(shown) == sorted(kept)
    for path in shown:
        head, rule, *rows = SITE["_table"](str(path.relative_to(ROOT))).splitlines()
        assert rule.split() == ["|", *["---", "|"] * (head.count("|") - 1)]
        assert rows
        assert {row.replace("\\|", "").count("|") for row in rows} == {head.count("|")}


@each_page
def test_no_line_is_too_wide_to_read(page):
    text = [re.sub(r"https?://\S+", "", line) for line in prose(page) if line[:1] != "|"]
    assert [line for line in text if len(line) > MAX_WIDTH] == []


@pytest.mark.parametrize("page", READABILITY["pages"](), ids=lambda page: page.name)
def test_no_sentence_is_too_long_to_read_once(page):
    found = READABILITY["sentences"](page.read_text("utf-8"))
    assert [text for text in found if READABILITY["words"](text) > MAX_WORDS] == []


@pytest.mark.parametrize(
    ("text", "lengths"),
    [
        ("One two `a b`, three.\nFour [five six](x.md#seven).", [4, 3]),
        ("* one; see Eq. 5\n  and 6\n* two, e.g. Three\n", [6, 3]),
        (
            "# One\n\n| a | b |\n\n    code a\n\n```sh\ncode\n```\n\n<!-- not run: a -->\nSaid.",
            [1],
        ),
    ],
)
def test_words_of_sentences_are_counted_without_code_and_tables(text, lengths):
    found = READABILITY["sentences"](text)
    assert [READABILITY["words"](sentence) for sentence in found] == lengths
