"""The pages: their links lead somewhere, and their lines can be read in any editor."""

import re
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
        if "://" not in file
    ]
    assert [file for file, _anchor in local if not file.exists()] == []
    assert [(f, a) for f, a in local if a and a not in anchors(f)] == []


@each_page
def test_no_line_is_too_wide_to_read(page):
    text = [re.sub(r"https?://\S+", "", line) for line in prose(page) if line[:1] != "|"]
    assert [line for line in text if len(line) > MAX_WIDTH] == []
