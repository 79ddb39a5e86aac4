"""A disk whose n-th call fails, and which knows what a power cut would leave of it.

The calls of ``rotcal_ros.foundation.disk`` are done for real, below one folder, and remembered:
what was synced survives for certain; of the rest a power cut leaves anything between nothing and
all. After a failed sync what was not on the medium is lost, and a later sync that succeeds
does not bring it back (as Linux does it).
"""

import errno
import os
import random
from dataclasses import dataclass, field
from pathlib import Path

from rotcal_ros.foundation import disk

MAKING = ("make_folder", "replace", "link")
REMOVING = ("remove", "remove_folder", "truncate")
ASKING = ("open_file", "status", "free_bytes", "may_write", "lock")
CALLS = ("write", "sync", "close", *MAKING, *REMOVING, *ASKING)

FAULTS = {
    "full": (errno.ENOSPC, ("write", "sync", "truncate", "create", "free_bytes", *MAKING)),
    "error": (errno.EIO, (*(call for call in CALLS if call != "may_write"), "create")),
    "read-only": (errno.EROFS, ("write", "create", "may_write", *MAKING, *REMOVING)),
    "short": (0, ("write",)),
    "short, then full": (errno.ENOSPC, ("write",)),
}
"""What can happen, the error it gives, and which calls it can happen to."""


@dataclass(frozen=True)
class Fault:
    """The fault ``name`` at the call number ``at``, once or from then on."""

    name: str
    at: int
    lasting: bool = False


@dataclass(eq=False)
class File:
    """A file (or folder) with its content now, and what is certain to survive."""

    data: bytearray = field(default_factory=bytearray)
    stable: bytes = b""
    lost: list[tuple[int, int]] = field(default_factory=list)

    def written_back(self) -> bytes:
        """Return the content as the medium has it when everything is written that still is."""
        content = bytearray(self.data)
        for begin, end in self.lost:
            content[begin:end] = bytes(len(content[begin:end]))
        return bytes(content)


class FaultyDisk:
    """Stands in for ``foundation.disk`` below ``root``; ``calls`` lists what was called."""

    def __init__(self, root: Path, fault: Fault | None = None) -> None:
        self.root = root
        self.fault = fault
        self.calls: list[str] = []
        self.hit = ""
        self.names: dict[Path, File | None] = {}
        self.stable_names: dict[Path, File | None] = {}
        self.open: dict[int, tuple[Path, File | None]] = {}
        self._real = {name: getattr(disk, name) for name in CALLS}

    def install(self, monkeypatch) -> None:
        for name in CALLS:
            monkeypatch.setattr(disk, name, getattr(self, name))

    def open_file(self, path, flags, mode=0o644):
        creates = bool(flags & os.O_CREAT) and not path.exists()
        self._call("create" if creates else "open_file")
        descriptor = self._real["open_file"](path, flags, mode)
        if creates:
            self.names[path] = File()
        self.open[descriptor] = (path, self.names.get(path))
        return descriptor

    def write(self, descriptor, data):
        size = max(1, len(data) // 2) if self._call("write") else len(data)
        data = bytes(data[:size])
        written = self._real["write"](descriptor, data)
        self.open[descriptor][1].data += data[:written]
        return written

    def sync(self, descriptor):
        path, file = self.open[descriptor]
        try:
            self._call("sync")
        except OSError:
            if file is not None:
                file.lost.append((len(file.stable), len(file.data)))
            raise
        if file is not None:
            file.stable = file.written_back()
            return
        for name in {*self.names, *self.stable_names}:
            if name.parent == path:
                if name in self.names:
                    self.stable_names[name] = self.names[name]
                else:
                    del self.stable_names[name]

    def truncate(self, descriptor, size):
        self._call("truncate")
        self._real["truncate"](descriptor, size)
        del self.open[descriptor][1].data[size:]

    def close(self, descriptor):
        del self.open[descriptor]
        self._real["close"](descriptor)
        self._call("close")

    def lock(self, descriptor):
        self._call("lock")
        self._real["lock"](descriptor)

    def replace(self, source, target):
        self._call("replace")
        self._real["replace"](source, target)
        self.names[target] = self.names.pop(source)

    def link(self, source, target):
        self._call("link")
        self._real["link"](source, target)
        self.names[target] = self.names[source]

    def make_folder(self, path, mode=0o777):
        self._call("make_folder")
        self._real["make_folder"](path, mode)
        self.names[path] = None

    def remove(self, path):
        self._call("remove")
        self._real["remove"](path)
        del self.names[path]

    def remove_folder(self, path):
        self._call("remove_folder")
        self._real["remove_folder"](path)
        del self.names[path]

    def status(self, path):
        self._call("status")
        return self._real["status"](path)

    def may_write(self, path):
        try:
            self._call("may_write")
        except OSError:
            return False
        return self._real["may_write"](path)

    def free_bytes(self, path):
        try:
            self._call("free_bytes")
        except OSError as error:
            if error.errno == errno.ENOSPC:
                return 0
            raise
        return self._real["free_bytes"](path)

    def power_cut(self, folder: Path, seed: int | None) -> None:
        """Put into ``folder`` what a power cut may leave: None: the least, -1: all, else drawn."""
        generator = random.Random(seed)
        for path in sorted({*self.names, *self.stable_names}):
            copy = folder / path.relative_to(self.root)
            names = self._surviving(generator, seed)
            if path not in names or not copy.parent.is_dir():
                continue
            file = names[path]
            if file is None:
                copy.mkdir()
            else:
                copy.write_bytes(self._content(file, generator, seed))

    def _surviving(self, generator, seed):
        if seed is None:
            return self.stable_names
        return self.names if seed < 0 or generator.random() < 0.5 else self.stable_names

    def _content(self, file, generator, seed):
        if seed is None:
            return file.stable
        whole = file.written_back()
        if seed < 0 or not whole.startswith(file.stable):
            return whole
        return whole[: generator.randint(len(file.stable), len(whole))]

    def _call(self, name) -> bool:
        """Count a call; fail as planned. True: only a part of the data shall be written."""
        number = len(self.calls)
        self.calls.append(name)
        if self.fault is None or number < self.fault.at:
            return False
        code, calls = FAULTS[self.fault.name]
        if name not in calls or not (self.fault.lasting or number == self.fault.at):
            return False
        partly = self.fault.name.startswith("short") and (code == 0 or number == self.fault.at)
        self.hit = self.hit or name
        if partly:
            return True
        raise OSError(code, os.strerror(code))


def faults(calls: list[str]) -> list[Fault]:
    """Return every fault that can happen to a run that makes these calls."""
    return [
        Fault(name, at, lasting)
        for at, call in enumerate(calls)
        for name, (_, possible) in FAULTS.items()
        if call in possible
        for lasting in (False, True)
        if lasting or name != "short, then full"
    ]
