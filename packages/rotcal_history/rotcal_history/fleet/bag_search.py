"""Finds bags in folders, globs, lists and remote places, each of them once.

Remote bags (``s3://...``) are distinguished by their last bytes and fetched once.
"""

from __future__ import annotations

import glob
import os
import re
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from fnmatch import translate
from pathlib import Path, PurePath, PurePosixPath
from typing import Any

from rotcal_ros.bags.reader import bag_files, is_storage_name
from rotcal_ros.bags.rosbag2_metadata import METADATA_FILE
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.untrusted import read_errors_as, read_text, require_no_secret

Inodes = frozenset[tuple[int, int]]


def find_bags(sources: Sequence[str]) -> tuple[str, ...]:
    """Return the bags that ``sources`` name: bags, folders of bags, globs, and lists of these.

    A list is a text file (``.txt``) with one bag per line, relative to itself; empty lines and
    those that begin with # are left out; a line that names nothing counts as a bag that cannot be
    read. URLs (``s3://...``) go through fsspec and are a file, a pattern with *, or a prefix, read
    like a folder. A bag that several paths or links lead to is returned once, under the first; a
    session stands for each of its files.

    Raises BagError when a source names nothing.
    """
    found = _NamedBags()
    for source in sources:
        named = False
        require_no_secret(source, "the bags to be solved")
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
        require_no_secret(bag, "the bags to be solved")
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
    """Return what all paths of a bag share: device and inode of its files."""
    if is_remote(bag):
        return frozenset()
    try:
        return frozenset((s.st_dev, s.st_ino) for s in map(Path.stat, bag_files(Path(bag))))
    except (BagError, OSError):
        return frozenset()


class _FolderSearch:
    """A search through folders and lists that enters none of them twice, so that loops end."""

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
            yield _absolute(path)
        elif glob.has_magic(source):
            for name in self._matching(source):
                yield from self.bags_of(name)

    def _listed(self, path: Path) -> Iterator[str]:
        if not self._enter(path):
            return
        with read_errors_as(path, BagError, "the list "):
            lines = read_text(path, "utf-8-sig").splitlines()
        for line in map(str.strip, lines):
            if line and not line.startswith("#"):
                yield from self._entry(line if is_remote(line) else str(path.parent / line))

    def _entry(self, source: str) -> Iterator[str]:
        """Yield the bags of a line; one that names nothing is a bag that cannot be read."""
        entered = not is_remote(source) and self._was_entered(Path(source))
        named = False
        for bag in self.bags_of(source):
            named = True
            yield bag
        if not named and not entered:
            yield source if is_remote(source) else _absolute(Path(source))

    def _in_folder(self, path: Path) -> Iterator[str]:
        """Yield the folder itself when it is a bag, else the bags in it, however deep."""
        if not self._enter(path):
            return
        try:
            inside = _inside(path)
        except OSError:
            yield _absolute(path)  # named as a bag that cannot be read
            return
        if any(is_storage_name(PurePath(entry.name)) for entry in inside):
            yield _absolute(path)
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

    def _was_entered(self, path: Path) -> bool:
        try:
            status = path.stat()
        except OSError:
            return False
        return (status.st_dev, status.st_ino) in self._entered

    def _enter(self, path: Path) -> bool:
        """Return whether the folder has not been entered before."""
        try:
            status = path.stat()
        except OSError:
            return False
        number = (status.st_dev, status.st_ino)
        first = number not in self._entered
        self._entered.add(number)
        return first


def _absolute(path: Path) -> str:
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


def is_remote(source: str) -> bool:
    """Return whether ``source`` is a URL."""
    return "://" in source


def remote_bags(source: str) -> Iterator[str]:
    """Yield the bags that a URL names: a file, what a pattern matches, or those below a prefix.

    A prefix that holds bag files itself is one session, as a folder is. Raises BagError when the
    place does not answer.
    """
    filesystem, path = _filesystem(source)
    try:
        filesystem.info(_fixed(path))  # a pattern does not report a place that does not answer
        places = sorted(filesystem.glob(path)) if glob.has_magic(path) else [path]
        for place in places:
            for bag in _below(filesystem, place):
                yield _url(source, bag)
    except FileNotFoundError:
        return
    except OSError as error:
        raise BagError(
            f"cannot read {source}: {error}; check the URL, and that you may read it"
        ) from error


def remote_files(source: str) -> tuple[str, ...]:
    """Return what belongs to a remote bag as paths of its file system: metadata.yaml too."""
    filesystem, path = _filesystem(source)
    if _is_storage(path):
        return (path,)
    inside = [name for name in filesystem.find(path, maxdepth=1) if _in(name, path)]
    return tuple(sorted(n for n in inside if _is_storage(n) or n.endswith(f"/{METADATA_FILE}")))


def remote_state(source: str, tail_bytes: int, *, whole: bool) -> Iterator[bytes]:
    """Yield what identifies the content of a remote bag, file by file, without fetching it.

    That is size, time or tag as the place states them, and the last ``tail_bytes``; with
    ``whole`` it is every byte, and nothing else.
    """
    filesystem, _ = _filesystem(source)
    for path in remote_files(source):
        if whole:
            with filesystem.open(path, "rb") as file:
                while part := file.read(1 << 20):
                    yield part
            continue
        facts = filesystem.info(path)
        size = int(facts["size"])
        known = [facts.get(name) for name in ("ETag", "mtime", "LastModified", "created")]
        yield f"{size} {[str(fact) for fact in known]}".encode()
        yield filesystem.cat_file(path, start=max(0, size - tail_bytes) or None)


@contextmanager
def local_copy(source: str) -> Iterator[Path]:
    """Give the bag as a local path, fetched into a temporary folder when it lies elsewhere."""
    if not is_remote(source):
        yield Path(source)
        return
    filesystem, path = _filesystem(source)
    files = remote_files(source)
    if not files:
        raise BagError(f"{source} names no bag: no .mcap or .db3 file is there; check the URL")
    with tempfile.TemporaryDirectory(prefix="rotcal_") as folder:
        name = PurePosixPath(path).name
        target = Path(folder) / name
        if files != (path,):
            target.mkdir()
        for file in files:
            to = target / PurePosixPath(file).name if target.is_dir() else target
            filesystem.get_file(file, str(to))
        yield target


def _below(filesystem: Any, place: str) -> Iterator[str]:
    if _is_storage(place) and filesystem.info(place)["type"] == "file":
        yield place
        return
    files = sorted(filter(_is_storage, filesystem.find(place)))
    folders = dict.fromkeys(str(PurePosixPath(file).parent) for file in files)
    outer = [f for f in folders if not any(str(up) in folders for up in PurePosixPath(f).parents)]
    yield from outer


def _fixed(path: str) -> str:
    """Return the path down to its first name with a pattern."""
    names = path.split("/")
    plain = next((i for i, name in enumerate(names) if glob.has_magic(name)), len(names))
    return "/".join(names[:plain])


def _is_storage(path: str) -> bool:
    return is_storage_name(PurePosixPath(path))


def _in(name: str, folder: str) -> bool:
    """Return whether a path is directly in a folder, with or without a leading slash."""
    return str(PurePosixPath(name).parent).strip("/") == folder.strip("/")


def _url(source: str, path: str) -> str:
    return f"{source.partition('://')[0]}://{path.removeprefix('/')}"


def _filesystem(source: str) -> tuple[Any, str]:
    """Return the file system of a URL and the path in it.

    S3 is read by Arrow, which is needed for the results anyway; like other programs it asks the
    environment: AWS_ENDPOINT_URL, AWS_ACCESS_KEY_ID, AWS_DEFAULT_REGION and so on.
    """
    try:
        from fsspec.core import url_to_fs
        from fsspec.implementations.arrow import ArrowFSWrapper
        from pyarrow import fs
    except ImportError as error:
        raise ConfigurationError(
            f"{source}: remote bags need fsspec and pyarrow: pip install 'rotcal_history[many]'"
        ) from error
    if not source.startswith("s3://"):
        filesystem, path = url_to_fs(source)
        return filesystem, path.rstrip("/")
    endpoint = os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL")
    options: dict[str, Any] = {"endpoint_override": endpoint} if endpoint else {}
    if region := os.environ.get("AWS_REGION") or os.environ.get("AWS_DEFAULT_REGION"):
        options["region"] = region
    path = source.removeprefix("s3://").rstrip("/")
    if not options:
        options["region"] = _region(source, path)
    return ArrowFSWrapper(fs.S3FileSystem(**options)), path


def _region(source: str, path: str) -> str:
    from pyarrow import fs

    try:
        return str(fs.resolve_s3_region(path.partition("/")[0]))
    except OSError as error:
        raise BagError(
            f"cannot read {source}: {error}; check the URL, and that you may read it"
        ) from error
