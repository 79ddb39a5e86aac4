"""Which bags are meant: in folders, globs, lists and remote places, each of them once."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Iterator, Sequence
from fnmatch import translate
from pathlib import Path, PurePath

from rotcal_ros.bags.reader import bag_files, is_storage_name
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.untrusted import read_text
from rotcal_ros.recordings.remote import is_remote, remote_bags

Inodes = frozenset[tuple[int, int]]


def find_bags(sources: Sequence[str]) -> tuple[str, ...]:
    """Return the bags that ``sources`` name: bags, folders of bags, globs, and lists of these.

    A list is a text file (``.txt``) with one bag per line, relative to itself; empty lines and
    those that begin with # are left out; a line that names nothing stays, as a bag that cannot be
    read. URLs (``s3://...``) go through fsspec and are a file, a
    pattern with *, or a prefix, which is read like a folder. What several paths or links lead to
    is taken once, under the first; a session stands for each of its files.

    Raises BagError when a source names nothing.
    """
    found = _NamedBags()
    for source in sources:
        named = False
        for bag in _FolderSearch().bags_of(source):
            named = True
            found.add(bag)
        if not named:
            raise BagError(f"{source} names no bag: expected bags, a folder, a glob or a list")
    return found.bags()


class _NamedBags:
    """Bags in the order in which they were named, each of them once."""

    def __init__(self) -> None:
        self._inodes: dict[str, Inodes] = {}
        self._owner: dict[tuple[int, int], str] = {}

    def add(self, bag: str) -> None:
        """Add a bag unless its files are there already; it replaces single files of it."""
        if bag in self._inodes:
            return
        inodes = _inodes(bag)
        owners = {self._owner[number] for number in inodes if number in self._owner}
        if any(inodes <= self._inodes[owner] for owner in owners):
            return
        for owner in owners:
            if self._inodes[owner] < inodes:
                del self._inodes[owner]
        self._inodes[bag] = inodes
        self._owner |= dict.fromkeys(inodes, bag)

    def bags(self) -> tuple[str, ...]:
        return tuple(self._inodes)


def _inodes(bag: str) -> Inodes:
    """Return what is the same under all paths of a bag: device and number of its files."""
    if is_remote(bag):
        return frozenset()
    try:
        return frozenset((s.st_dev, s.st_ino) for s in map(Path.stat, bag_files(Path(bag))))
    except (BagError, OSError):
        return frozenset()


class _FolderSearch:
    """One way through folders and lists that enters none of them twice, so that loops end."""

    def __init__(self) -> None:
        self._entered: set[tuple[int, int]] = set()

    def bags_of(self, source: str) -> Iterator[str]:
        path = Path(source)
        if is_remote(source):
            yield from remote_bags(source)
        elif path.suffix == ".txt" and path.is_file():
            yield from self._listed(path)
        elif path.is_dir():
            yield from self._in_folder(path)
        elif is_storage_name(path) and path.is_file():
            yield _plain(path)
        elif glob.has_magic(source):
            for name in self._matching(source):
                yield from self.bags_of(name)

    def _listed(self, path: Path) -> Iterator[str]:
        if not self._enter(path):
            return
        try:
            lines = read_text(path, "utf-8-sig").splitlines()
        except (OSError, UnicodeDecodeError) as error:
            raise BagError(f"cannot read the list {path}: {error}") from error
        for line in map(str.strip, lines):
            if line and not line.startswith("#"):
                yield from self._entry(line if is_remote(line) else str(path.parent / line))

    def _entry(self, source: str) -> Iterator[str]:
        """Yield the bags of a line; one that names nothing is a bag that cannot be read."""
        known = not is_remote(source) and self._known(Path(source))
        named = False
        for bag in self.bags_of(source):
            named = True
            yield bag
        if not named and not known:
            yield source if is_remote(source) else _plain(Path(source))

    def _in_folder(self, path: Path) -> Iterator[str]:
        """Yield the folder itself when it is a bag, else the bags in it, however deep."""
        if not self._enter(path):
            return
        try:
            inside = _inside(path)
        except OSError:
            yield _plain(path)  # named as a bag that cannot be read
            return
        if any(is_storage_name(PurePath(entry.name)) for entry in inside):
            yield _plain(path)
            return
        for entry in filter(_is_folder, inside):
            yield from self._in_folder(path / entry.name)

    def _matching(self, pattern: str) -> Iterator[str]:
        """Yield what a glob matches, sorted; ``**`` follows no loop of links."""
        if "**" not in pattern:
            yield from sorted(glob.glob(pattern))  # noqa: PTH207  absolute globs too
            return
        base = Path(*_before_magic(Path(pattern).parts))
        matches = _compiled(pattern)
        walk = _FolderSearch()
        yield from sorted(str(p) for p in walk.below(base) if matches.fullmatch(f"{p}/"))

    def below(self, folder: Path) -> Iterator[Path]:
        """Yield everything below a folder that can be entered."""
        if not self._enter(folder):
            return
        try:
            inside = _inside(folder)
        except OSError:
            return
        for entry in inside:
            path = folder / entry.name
            yield path
            if _is_folder(entry):
                yield from self.below(path)

    def _known(self, path: Path) -> bool:
        """Return whether it was entered before."""
        try:
            status = path.stat()
        except OSError:
            return False
        return (status.st_dev, status.st_ino) in self._entered

    def _enter(self, path: Path) -> bool:
        """Return whether this is the first time here."""
        try:
            status = path.stat()
        except OSError:
            return False
        number = (status.st_dev, status.st_ino)
        first = number not in self._entered
        self._entered.add(number)
        return first


def _plain(path: Path) -> str:
    """Return an absolute path; ``..`` stays, it may lead through a link."""
    return str(path.absolute())


def _inside(folder: Path) -> list[os.DirEntry[str]]:
    """Return the entries of a folder by name; with their kinds, which costs no further calls."""
    with os.scandir(folder) as entries:
        return sorted(entries, key=lambda entry: entry.name)


def _is_folder(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_dir()
    except OSError:  # a link to itself
        return False


def _before_magic(parts: Sequence[str]) -> Iterator[str]:
    for part in parts:
        if glob.has_magic(part):
            return
        yield part


def _compiled(pattern: str) -> re.Pattern[str]:
    """Return a glob as a regular expression for paths that end in a slash.

    A * stays within a name, a ** does not.
    """
    names = []
    for part in Path(pattern).parts:
        if part == "**":
            names.append("(?:[^/]+/)*")
        elif part == "/":
            names.append("/")
        else:
            inside = translate(part).replace(".*", "[^/]*")
            names.append(re.sub(r"\\[Zz]$", "", inside) + "/")
    return re.compile("".join(names))
