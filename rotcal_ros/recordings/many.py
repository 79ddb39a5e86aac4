"""Many bags with one configuration: found, fingerprinted, solved one by one wherever they lie."""

from __future__ import annotations

import glob
import hashlib
import json
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final
from uuid import uuid4

from rotcal_ros import __version__
from rotcal_ros.bags import names
from rotcal_ros.bags.reader import bag_files, sha256_of
from rotcal_ros.catalogue.configuration import Configuration, parse_configuration
from rotcal_ros.errors import BagError, ConfigurationError, RotcalError
from rotcal_ros.files import write_atomically
from rotcal_ros.recordings.replay import Recording, read_recording
from rotcal_ros.results import Result

Identity = str | frozenset[tuple[int, int]]
SUFFIXES: Final = (".mcap", ".db3")


@dataclass(frozen=True)
class Job:
    """One bag to be solved: ``source`` is a path or an fsspec URL; ``cache`` takes the outcome."""

    source: str
    configuration: Configuration
    cache: str


@dataclass(frozen=True)
class Outcome:
    """What became of one bag; ``error`` is empty when there is a result.

    ``table`` tells rotary tables apart: cell and axis of the configuration that the bag was
    recorded with, else the folder it lies in. ``start_ns`` is the log time of the first message.
    ``cached`` tells that nothing had to be computed: the same content with the same
    configuration was solved before.
    """

    source: str
    key: str
    table: str = ""
    start_ns: int | None = None
    result: dict[str, Any] | None = None
    warnings: tuple[str, ...] = ()
    error: str = ""
    seconds: float = 0.0
    cached: bool = False

    def deviations(self) -> Result | None:
        """Return the result, None when there is none."""
        return None if self.result is None else Result.from_dict(self.result)


def find_bags(sources: Sequence[str]) -> tuple[str, ...]:
    """Return the bags that ``sources`` name: bags, folders of bags, globs, and lists of these.

    A list is a text file (``.txt``) with one bag per line, relative to itself; empty lines and
    those that begin with # are left out. URLs (``s3://...``) go through fsspec and must end in
    .mcap or .db3, with * for many. What two paths or links lead to is taken once, under the first.

    Raises BagError when a source names nothing.
    """
    found: dict[Identity, str] = {}
    for source in sources:
        bags = tuple(_bags_of(source))
        if not bags:
            raise BagError(f"{source} names no bag: expected bags, a folder, a glob or a list")
        for bag in bags:
            found.setdefault(_identity(bag), bag)
    return tuple(found.values())


def _identity(bag: str) -> Identity:
    """Return what is the same under all paths of a bag: device and number of its files."""
    if "://" in bag:
        return bag
    try:
        return frozenset((s.st_dev, s.st_ino) for s in map(Path.stat, bag_files(Path(bag))))
    except (BagError, OSError):
        return bag


def solve_bag(job: Job) -> Outcome:
    """Solve one bag; whatever goes wrong with it becomes part of the outcome."""
    begin = time.perf_counter()
    key = ""
    try:
        with _local(job.source) as path:
            key = fingerprint(path, job.configuration)
            cached = Path(job.cache) / f"{key}.json"
            if cached.exists():
                known = json.loads(cached.read_text(encoding="utf-8"))
                known |= {"warnings": tuple(known["warnings"]), "source": job.source}
                return Outcome(**known | {"cached": True})
            outcome = _solve(job, path, key, begin)
        # Two workers with the same bag write it under names of their own.
        own = cached.with_suffix(f".{uuid4().hex}")
        write_atomically(own, json.dumps(asdict(outcome)))
        own.replace(cached)
    except Exception as error:  # one bad bag does not stop the rest
        # Our own texts explain themselves.
        kind = "" if isinstance(error, RotcalError) else f"unexpected {type(error).__name__}: "
        what = f"{kind}{error}"
        return Outcome(job.source, key, error=what, seconds=time.perf_counter() - begin)
    return outcome


def fingerprint(path: Path, configuration: Configuration) -> str:
    """Return the hash of a bag's content, the configuration and the version that solves it."""
    digest = hashlib.sha256(f"{__version__} {configuration.plan_id}".encode())
    for file in bag_files(path):
        digest.update(sha256_of(file).encode())
    return digest.hexdigest()


def _solve(job: Job, path: Path, key: str, begin: float) -> Outcome:
    recording = read_recording(path, configuration=job.configuration)
    starts = [v.start_ns for v in recording.verdicts if v.start_ns is not None]
    return Outcome(
        source=job.source,
        key=key,
        table=_table(recording, job.source),
        start_ns=min(starts, default=None),
        result=recording.solve().to_dict(),
        warnings=recording.warnings(),
        seconds=time.perf_counter() - begin,
    )


def _table(recording: Recording, source: str) -> str:
    """Return what tells tables apart: namespace and axis as recorded, else the folder's name."""
    text = recording.attachments.get(names.CONFIGURATION, b"").decode(errors="replace")
    with suppress(ConfigurationError):
        recorded = parse_configuration(text, groups=("cell",))
        if "cell" in recorded.given:
            return f"{recorded.cell.namespace} {recorded.cell.axis}"
    return source.rstrip("/").rpartition("/")[0].rpartition("/")[2]


def _bags_of(source: str) -> Iterator[str]:
    path = Path(source)
    if "://" in source:
        yield from _remote(source)
    elif path.suffix == ".txt" and path.is_file():
        yield from _listed(path)
    elif glob.has_magic(source):
        for name in sorted(glob.glob(source, recursive=True)):  # noqa: PTH207  absolute globs too
            yield from _bags_of(name)
    elif path.suffix in SUFFIXES and path.is_file():
        yield str(path.absolute())
    elif path.is_dir():
        yield from _in_folder(path)


def _listed(path: Path) -> Iterator[str]:
    for line in map(str.strip, path.read_text(encoding="utf-8").splitlines()):
        if line and not line.startswith("#"):
            yield from _bags_of(line if "://" in line else str(path.parent / line))


def _in_folder(path: Path) -> Iterator[str]:
    """Yield the folder itself when it is a bag, else the bags in it, however deep."""
    if any(file.suffix in SUFFIXES for file in path.iterdir()):
        yield str(path.absolute())
    else:
        for folder in sorted(p for p in path.iterdir() if p.is_dir()):
            yield from _in_folder(folder)


def _remote(source: str) -> Iterator[str]:
    filesystem, path = _filesystem(source)
    names = sorted(filesystem.glob(path)) if glob.has_magic(path) else [path]
    yield from (filesystem.unstrip_protocol(name) for name in names)


def _filesystem(source: str) -> tuple[Any, str]:
    try:
        from fsspec.core import url_to_fs
    except ImportError as error:
        raise ConfigurationError(
            f"{source}: remote bags need fsspec: pip install 'rotcal_ros[many]'"
        ) from error
    filesystem, path = url_to_fs(source)
    return filesystem, path


@contextmanager
def _local(source: str) -> Iterator[Path]:
    """Give the bag as a local path, fetched into a temporary folder when it lies elsewhere."""
    if "://" not in source:
        yield Path(source)
        return
    filesystem, path = _filesystem(source)
    with tempfile.TemporaryDirectory(prefix="rotcal_") as folder:
        target = Path(folder) / Path(path).name
        filesystem.get_file(path, str(target))
        yield target
