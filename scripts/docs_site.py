"""What ``make docs`` does beyond MkDocs: pages from elsewhere, the command line, a last look.

The pages link to other files of the repository, as on a code host: those files come along
under ``repository/``. Some pages are made of the code. A page asks nothing of any server, which is
looked at in the end.
"""

from __future__ import annotations

import csv
import posixpath
import re
import runpy
from pathlib import Path

import click
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from rotcal_ros.cli.main import rotcal

ROOT = Path(__file__).resolve().parents[1]
FOLDER = "repository"
PAGES = (
    "CONTRIBUTING.md",
    "examples/README.md",
    "examples/own_controller/README.md",
    "examples/own_method/README.md",
)
"""Pages that live beside what they are about, and belong to the site."""
MADE = {
    "messages.md": ("messages_page.py", "page"),
    "settings.md": ("settings_page.py", "page"),
    "troubleshooting.md": ("troubleshooting.py", "page"),
    "result.schema.json": ("result_schema.py", "text"),
}
"""Files of the site that scripts make: the script, and its function."""
LINK = re.compile(r"\[(?P<text>[^\]]*)\]\((?P<target>[^)\s#]+)(?P<anchor>#[^)]*)?\)")
TABLE = re.compile(r"^\[[^\]\n]*\]\((?P<path>\S+\.csv)\)$", re.MULTILINE)
"""A link to a table alone on its line: the site shows the table below it."""
COMMANDS = "command_line.md"
FILLED = {
    "api.md": "api_page.py",
    "controllers.md": "controllers_page.py",
    "result_json.md": "result_schema.py",
}
"""Pages with places that the function ``filled`` of a script fills."""
REFERENCE = """
::: mkdocs-click
    :module: rotcal_ros.cli.main
    :command: rotcal
    :prog_name: rotcal
    :depth: 1
    :style: table
"""
ASKED = re.compile(
    r"""<(?:script|img|iframe|source|link)\b[^>]*?(?:src|href)=["']?((?:https?:)?//[^"'\s>]+)"""
    r"""|(?:@import|url\()\s*["']?((?:https?:)?//[^"'\s)]+)""",
    re.IGNORECASE,
)
"""What a browser would fetch by itself; links that a person may follow are not meant."""


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Give every verb the name that it is called by, which is not that of its function."""
    _name(rotcal)
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Bring what is made, the pages that live elsewhere and every file that some page links to."""
    inside = [file.src_uri for file in files.documentation_pages()]
    wanted = set(PAGES)
    for page in [*(f"docs/{uri}" for uri in inside), *PAGES]:
        targets = (_target(page, link["target"]) for link in LINK.finditer(_text(page)))
        wanted |= {target for target in targets if _is_outside(target)}
    for path in sorted(wanted):
        files.append(File.generated(config, f"{FOLDER}/{path}", abs_src_path=str(ROOT / path)))
    for uri, (script, function) in MADE.items():
        text = runpy.run_path(str(ROOT / "scripts" / script))[function]()
        files.append(File.generated(config, uri, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Let the links of a page lead to where their targets are in the site."""
    uri = page.file.src_uri
    here = uri.removeprefix(f"{FOLDER}/") if uri.startswith(FOLDER) else f"docs/{uri}"

    def moved(link: re.Match[str]) -> str:
        target = _target(here, link["target"])
        if not target:
            return link[0]
        place = _place(target)
        if not place:  # a folder: the site has files only
            return link["text"]
        leads = posixpath.relpath(place, posixpath.dirname(uri))
        return f"[{link['text']}]({leads}{link['anchor'] or ''})"

    if script := FILLED.get(uri):
        markdown = runpy.run_path(str(ROOT / "scripts" / script))["filled"](markdown)
    markdown = TABLE.sub(
        lambda link: f"{link[0]}\n\n{_table(_target(here, link['path']))}", markdown
    )
    return LINK.sub(moved, markdown) + (REFERENCE if uri == COMMANDS else "")


def on_post_build(config: MkDocsConfig) -> None:
    """End with an error when a page would ask a server for anything."""
    site = Path(config.site_dir)
    asked = {
        f"{path.relative_to(site)}: {found[1] or found[2]}"
        for suffix in ("html", "css")
        for path in site.rglob(f"*.{suffix}")
        for found in ASKED.finditer(path.read_text(encoding="utf-8"))
    }
    if asked:
        raise PluginError("pages ask servers for something:\n" + "\n".join(sorted(asked)))


def _name(group: click.Group) -> None:
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        command.name = name
        if isinstance(command, click.Group):
            _name(command)


def _text(path: str) -> str:
    return (ROOT / path).read_text(encoding="utf-8")


def _table(path: str) -> str:
    """Return a table of the repository in Markdown."""
    head, *rows = csv.reader(_text(path).splitlines())
    return "\n".join(f"| {' | '.join(row)} |" for row in [head, ["---"] * len(head), *rows])


def _target(page: str, link: str) -> str:
    """Return the path in the repository that a link of ``page`` leads to; "" for an address."""
    if "://" in link or link.startswith("mailto:"):
        return ""
    return posixpath.normpath(posixpath.join(posixpath.dirname(page), link))


def _is_outside(target: str) -> bool:
    return bool(target) and not target.startswith("docs/") and (ROOT / target).is_file()


def _place(target: str) -> str:
    """Return where in the site a file of the repository is; "" for a folder without a page."""
    if (ROOT / target).is_dir():
        target = f"{target}/README.md"
        if target not in PAGES:
            return ""
    return target.removeprefix("docs/") if target.startswith("docs/") else f"{FOLDER}/{target}"
