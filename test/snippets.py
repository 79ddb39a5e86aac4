"""The code blocks of the pages, and what the comments above them say about running them.

A block runs unless a comment directly above says why not, in one of these forms:

    <!-- not run: REASON -->
    <!-- run by test/.../test_it.py -->
    <!-- lines `rotcal run` not run: REASON -->
    <!-- lines `rotcal run` run by test/.../test_it.py -->

The last two speak of the commands of the block that begin so; the others run.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    path
    for pattern in ("README.md", "CONTRIBUTING.md", "docs/**/*.md", "examples/**/*.md")
    for path in ROOT.glob(pattern)
)
SHELL, PYTHON, YAML = "shell", "python", "yaml"
LANGUAGES = {
    **dict.fromkeys(("sh", "bash", "console", "fish", "zsh"), SHELL),
    **dict.fromkeys(("python", "py"), PYTHON),
    **dict.fromkeys(("yaml", "yml"), YAML),
}
PROGRAMS = [
    "rotcal",
    "make",
    "pip",
    "python",
    "docker",
    "pixi",
    "apt",
    "colcon",
    "ros2",
    "openssl",
    "eval",
    "export",
]
COMMAND = re.compile(
    rf"^(?:[A-Z_]+=\S+ |\()*(?:(?:\S*/)?(?:{'|'.join(PROGRAMS)})|\. \S*/\S+)[ \n]", re.M
)
COMMENT = re.compile(r"<!--\s*(.*?)\s*-->", re.S)
MARK = re.compile(
    r"(?:lines `(?P<lines>[^`]+)` )?(?:not run: (?P<reason>\S.*)|run by (?P<files>\S.*))"
)
SPEAKS_OF_RUNNING = re.compile(r"\b(not run|run by)\b")


@dataclass(frozen=True)
class Mark:
    """Which commands do not run here (all: ""), and why not or by which tests they do."""

    lines: str
    reason: str
    files: tuple[str, ...]


@dataclass(frozen=True)
class Block:
    """A block of code: where it stands, what it is in, its text, what is said about it."""

    page: Path
    line: int
    kind: str
    text: str
    comments: tuple[str, ...]

    @property
    def place(self) -> str:
        """Say where it stands: README.md:40."""
        return f"{self.page.relative_to(ROOT)}:{self.line}"

    def marks(self) -> tuple[Mark, ...]:
        """Return what is said about running it; ValueError for what is said badly."""
        return tuple(self._mark(c) for c in self.comments if SPEAKS_OF_RUNNING.search(c))

    def _mark(self, comment: str) -> Mark:
        match = MARK.fullmatch(" ".join(comment.split()))
        if match is None:
            raise ValueError(f"{self.place}: no reason, or no test, in {comment!r}")
        files = tuple((match["files"] or "").replace(",", " ").split())
        return Mark(match["lines"] or "", match["reason"] or "", files)

    def commands(self) -> list[str]:
        """Return the commands of a shell block, continued lines as one."""
        return re.findall(r"^\S(?:.*\\\n)*.*", self.text, re.M)

    def left_to(self, mark: Mark) -> list[str]:
        """Return the commands that a mark speaks of."""
        return [command for command in self.commands() if command.startswith(mark.lines)]

    def to_run(self) -> str:
        """Return what is left to be run here; "" for nothing."""
        marks = self.marks()
        if self.kind != SHELL or not marks:
            return "" if marks else self.text
        left = {command for mark in marks for command in self.left_to(mark)}
        return "\n".join(c for c in self.commands() if c not in left and c[0] != "#")


def blocks(page: Path) -> Iterator[Block]:
    """Yield the code blocks of a page, fenced ones and indented ones."""
    lines = page.read_text(encoding="utf-8").splitlines()
    number = 0
    while number < len(lines):
        fence = re.match(r"```(\w*)\s*$", lines[number])
        if fence:
            end = next(n for n in range(number + 1, len(lines)) if lines[n].strip() == "```")
            text = "\n".join(lines[number + 1 : end])
            yield _block(page, lines, number, text, LANGUAGES.get(fence[1], fence[1]))
            number = end + 1
        elif lines[number].startswith("    ") and _begins(lines, number):
            end = number
            while end < len(lines) and (lines[end].startswith("    ") or not lines[end]):
                end += 1
            text = "\n".join(line[4:] for line in lines[number:end]).rstrip()
            yield _block(page, lines, number, text, "")
            number = end
        else:
            number += 1


def _begins(lines: list[str], number: int) -> bool:
    """Does an indented block begin here, and not the next paragraph of a list?"""
    if lines[number - 1].strip():
        return False
    before = next((line for line in reversed(lines[:number]) if line.strip()), "")
    return not re.match(r"([*-]|\d+\.) |  ", before)


def _block(page: Path, lines: list[str], number: int, text: str, language: str) -> Block:
    above = number - 1
    comments = []
    while above >= 0 and (not lines[above].strip() or lines[above].endswith("-->")):
        if lines[above].strip():
            first = above
            while "<!--" not in lines[first]:
                first -= 1
            comments += COMMENT.findall("\n".join(lines[first : above + 1]))
            above = first
        above -= 1
    return Block(page, number + 1, language or _kind(text), text, tuple(comments))


def _kind(text: str) -> str:
    """Guess what a block without a language is in; "" for no code."""
    if COMMAND.search(f"{text}\n"):
        return SHELL
    if text.startswith("/**:") or re.match(r"\w+:(?: \{|$)", text.splitlines()[0]):
        return YAML
    if "import rotcal_ros" in text or " = rc." in text:
        ast.parse(text)
        return PYTHON
    return ""
