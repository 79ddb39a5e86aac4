"""Remote bags (``s3://...``): found, told apart by their last bytes, fetched once."""

from __future__ import annotations

import glob
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any, Final

from rotcal_ros.bags.reader import is_storage_name
from rotcal_ros.foundation.errors import BagError, ConfigurationError

METADATA: Final = "metadata.yaml"


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
        raise BagError(f"cannot read {source}: {error}") from error


def remote_files(source: str) -> tuple[str, ...]:
    """Return what belongs to a remote bag as paths of its file system: metadata.yaml too."""
    filesystem, path = _filesystem(source)
    if _is_storage(path):
        return (path,)
    inside = [name for name in filesystem.find(path, maxdepth=1) if _in(name, path)]
    return tuple(sorted(n for n in inside if _is_storage(n) or n.endswith(f"/{METADATA}")))


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
def local(source: str) -> Iterator[Path]:
    """Give the bag as a local path, fetched into a temporary folder when it lies elsewhere."""
    if not is_remote(source):
        yield Path(source)
        return
    filesystem, path = _filesystem(source)
    files = remote_files(source)
    if not files:
        raise BagError(f"{source} names no bag: no .mcap or .db3 file is there")
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
            f"{source}: remote bags need fsspec and pyarrow: pip install 'rotcal_ros[many]'"
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
        raise BagError(f"cannot read {source}: {error}") from error
