"""Calibrations without end, and something happens to each: how does it end.

usage: python scripts/endurance.py [--minutes 120] [--hours 6] [--seed 1]

All methods in turn, the table at rest and turning, under one trouble after the other: load that
changes, nodes that stand still, a node that is killed, a clock that jumps, a disk that is full for
a while, a stranger who publishes. A session ends right when its verdict is ok and its result that
of the quiet one, or when it says why not: a verdict with its reason, an error in one line. What
was broken off is continued. A controller's table can be made of a result that is ok, and of no
other. No process may be left behind.

Each session is a line of out/endurance/sessions.jsonl, whose minutes add up until --hours. At the
end: is memory, time and disk of the last sessions that of the first, and is the history of all
results whole? Exit code 1 where something is wrong. Needs root for the full disk (a tmpfs) and cc
for the clock; without them these troubles are left out, and named.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

from soak import MOST, ROOT, SESSIONS, Nodes, busy, command_of, difference

from rotcal_ros.foundation.middleware import middleware
from rotcal_ros.sessions.domains import free_domain

sys.path.append(str(ROOT / "test" / "nodes"))
from jumping_clock import JumpingClock

PLACE = ROOT / "out" / "endurance"
LINES = PLACE / "sessions.jsonl"
ROTCAL = (sys.executable, "-m", "rotcal_ros.cli.main")
HISTORY = ("history", "--database", str(PLACE / "history.db"))
DEADLINE_S = 1200.0
TABLE = ("identity.serial=endurance",)
BEGUN_S = (8.0, 25.0)
"""A trouble begins so long after a session."""
FULL_S, DISK = 15.0, "200m"
GROWTH = 1.2
"""Most that the last third of the sessions may need of what the first third needs."""
REFUSED = 3
"""Exit code of ``rotcal export`` where a verdict forbids the table."""
Trouble = Callable[["Session"], None]


class Session:
    """One calibration and what happens to it."""

    def __init__(self, method: str, folder: Path, generator: random.Random) -> None:
        self.method, self.folder, self.generator = method, folder, generator
        self.environment = {**os.environ, **middleware(os.environ)}
        self.environment["ROS_DOMAIN_ID"] = str(free_domain())
        self.noted: dict[str, Any] = {}
        self._ended = threading.Event()

    def run(self, *more: str) -> tuple[int, str]:
        """Calibrate; return exit code and the output; -1 for a session that did not end."""
        command = [*command_of(self.method, TABLE), *more]
        process = subprocess.Popen(
            command, cwd=ROOT, env=self.environment, text=True, start_new_session=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip
        self.nodes = Nodes(process.pid, self.generator, stops="stops" in self.noted)
        try:
            out, error = process.communicate(timeout=DEADLINE_S)
            if process.returncode:
                self.noted["error"] = error.strip().splitlines()[-1:]
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            return -1, ""
        finally:
            self.nodes.end()
            self._ended.set()
        return process.returncode, out

    def wait(self, span_s: tuple[float, float] = BEGUN_S) -> bool:
        """Wait until a trouble begins; return whether the session runs."""
        return not self._ended.wait(self.generator.uniform(*span_s))

    def left_behind(self) -> list[int]:
        """Return the processes of the session's domain that run."""
        mark = f"ROS_DOMAIN_ID={self.environment['ROS_DOMAIN_ID']}".encode()
        found = []
        for folder in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):
                if mark in (folder / "environ").read_bytes().split(b"\0"):
                    found.append(int(folder.name))
        return found


@contextmanager
def happening(session: Session, what: Trouble) -> Iterator[None]:
    """Let something happen beside what is done inside."""
    thread = threading.Thread(target=what, args=(session,))
    thread.start()
    try:
        yield
    finally:
        thread.join()


def kill(session: Session) -> None:
    """Kill a node at random."""
    if session.wait() and (nodes := session.nodes.found()):
        session.noted["killed"] = session.generator.choice(sorted(nodes))
        with suppress(ProcessLookupError):
            os.kill(nodes[session.noted["killed"]], signal.SIGKILL)


def jump(session: Session, clock: JumpingClock, far_s: float) -> None:
    """Let the clock of the session jump."""
    if session.wait():
        clock.jump(far_s)


def intrude(session: Session) -> None:
    """Let a stranger publish points, positions and observations of its own."""
    if session.wait():
        script = ROOT / "test" / "nodes" / "second_probe.py"
        stranger = subprocess.Popen(
            [sys.executable, script], env=session.environment, stderr=subprocess.DEVNULL
        )
        while session.wait((1.0, 1.0)):
            pass
        stranger.kill()
        stranger.wait()


def fill(session: Session) -> None:
    """Fill the disk of the session, and free it again."""
    filler = session.folder.parent / "filler"
    if session.wait():
        with suppress(OSError), filler.open("wb") as file:
            while file.write(bytes(1 << 20)):
                file.flush()
        session.wait((FULL_S, FULL_S))
        filler.unlink()


@contextmanager
def trouble(name: str, session: Session, place: Path) -> Iterator[None]:
    """Let the trouble ``name`` happen to a session."""
    with ExitStack() as stack:
        if name == "busy":
            stack.enter_context(busy(session.generator.choice((2, 4, 8))))
        elif name == "stops":
            session.noted["stops"] = True
        elif name == "clock":
            clock = JumpingClock(place)
            session.environment |= clock.environment
            far_s = session.noted["jump_s"] = session.generator.choice(
                (-3600.0, -5.0, 3.0, 7200.0)
            )
            stack.enter_context(happening(session, partial(jump, clock=clock, far_s=far_s)))
        elif name == "full disk":
            subprocess.run(
                ("mount", "-t", "tmpfs", "-o", f"size={DISK}", "none", place), check=True
            )
            stack.callback(subprocess.run, ("umount", "--lazy", place), check=True)
            stack.enter_context(happening(session, fill))
        elif name in BESIDE:
            stack.enter_context(happening(session, BESIDE[name]))
        yield


BESIDE: dict[str, Trouble] = {"kill": kill, "intruder": intrude}
TROUBLES = ("none", "busy", "kill", "clock", "stops", "full disk", "intruder")


def possible() -> list[str]:
    """Return the troubles that this machine can make."""
    can = {"full disk": os.geteuid() == 0, "clock": shutil.which("cc") is not None}
    return [name for name in TROUBLES if can.get(name, True)]


def calibrated(method: str, name: str, generator: random.Random) -> dict[str, Any]:
    """Calibrate under a trouble; continue what was broken off; return what came of it."""
    begin, quiet = time.monotonic(), PLACE / f"{method}.json"
    with tempfile.TemporaryDirectory(prefix="endurance") as text:
        place, folder = Path(text), Path(text) / "session"
        session = Session(method, folder, generator)
        with trouble(name, session, place):
            code, out = session.run("-o", str(folder))
            noted = dict(session.noted)
            calm = Session(method, folder, generator)
            runs = 1
            while code not in (0, 1) and runs < 3 and folder.exists():
                code, out = calm.run("--resume", str(folder))
                runs += 1
            found = {
                "method": method, "trouble": name, **noted, "code": code, "runs": runs,
                "seconds": round(time.monotonic() - begin),
                "resume_error": calm.noted.get("error", []),
                "mb": {n: round(s[-1][1]) for n, s in session.nodes.memory.items()},
            }  # fmt: skip
            if code in (0, 1) and out.startswith("{"):
                result = folder / "result.json"
                stored = json.loads(result.read_text())
                found |= {"verdict": stored["verdict"], "reasons": stored["warnings"][:3]}
                if name == "none" and not quiet.exists():
                    quiet.write_bytes(result.read_bytes())
                if quiet.exists():
                    found["difference"] = round(difference(quiet, result), 2)
                added = rotcal(*HISTORY, "add", str(result))
                found["in_history"] = added.returncode == 0
                found |= {} if found["in_history"] else {"history_says": added.stderr[-200:]}
                export = ("export", str(result), "--to", "csv", "--replace")
                found["feed_code"] = rotcal(*export, "--out", str(place / "table")).returncode
        found["left_behind"] = len(session.left_behind() + calm.left_behind())
    return found


def rotcal(*words: str) -> subprocess.CompletedProcess[str]:
    """Run a command of the program to its end."""
    return subprocess.run((*ROTCAL, *words), cwd=ROOT, capture_output=True, text=True, check=False)


def wrong(found: dict[str, Any]) -> str:
    """Return what is wrong with a session; empty: it ended right, or said why not."""
    error = "".join(found.get("error", []) + found["resume_error"])
    verdict = found.get("verdict")
    faults = {
        "it did not end": found["code"] == -1,
        "an error of the program": "Traceback" in error or "Error:" in error,
        "it does not say why": found["code"] not in (-1, 0, 1) and not error,
        "suspect without a reason": verdict not in ("ok", None) and not found["reasons"],
        "a peaceful one is not ok": found["trouble"] == "none" and verdict != "ok",
        "ok and another result": verdict == "ok" and found.get("difference", 0.0) > MOST,
        "processes are left behind": found["left_behind"] > 0,
        "not in the history": verdict is not None and not found.get("in_history"),
        "the feed and the verdict differ": found.get("feed_code", REFUSED)
        != (0 if verdict == "ok" else REFUSED),
    }
    return "; ".join(text for text, is_so in faults.items() if is_so)


def summary(done: list[dict[str, Any]]) -> Iterator[str]:
    """Yield what all sessions together show, a line each; what is wrong begins so."""
    for name in TROUBLES:
        of_it = [found for found in done if found["trouble"] == name]
        counts = Counter(found.get("verdict") or "refused" for found in of_it)
        broken_off = sum(found["runs"] > 1 for found in of_it)
        ended = ", ".join(f"{count} {verdict}" for verdict, count in sorted(counts.items()))
        yield f"{name}: {len(of_it)} sessions, {broken_off} broken off and continued; {ended}"
    needs = defaultdict[str, list[float]](list)
    for found in done:
        for node, megabytes in found["mb"].items():
            needs[f"MB of {node}, {found['method']}"].append(megabytes)
        if found["trouble"] == "none":
            needs[f"seconds of {found['method']}"].append(found["seconds"])
    for what, values in sorted(needs.items()):
        if third := len(values) // 3:
            first, last = median(values[:third]), median(values[-third:])
            if third > 1 and last > GROWTH * first:
                yield f"wrong: {what} grew from {first:.0f} to {last:.0f}"
    check = rotcal(*HISTORY, "check")
    kept = sum(found.get("in_history", False) for found in done)
    yield f"{'wrong: ' * (check.returncode != 0)}history of {kept}: {check.stdout.strip()[-120:]}"
    yield from (f"wrong: {f['method']}, {f['trouble']}: {w}" for f in done if (w := wrong(f)))


def main() -> int:
    """Calibrate until the time is up, and say what came of all so far."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=120.0, help="in one go")
    parser.add_argument("--hours", type=float, default=6.0, help="in all")
    parser.add_argument("--methods", nargs="+", default=list(SESSIONS), choices=list(SESSIONS))
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    PLACE.mkdir(parents=True, exist_ok=True)
    done = [json.loads(line) for line in LINES.read_text().splitlines()] if LINES.exists() else []
    troubles, begin = possible(), time.monotonic()
    generator = random.Random(f"{asked.seed} {len(done)}")
    while (
        time.monotonic() - begin < 60.0 * asked.minutes
        and sum(found["seconds"] for found in done) < 3600.0 * asked.hours
    ):
        number = len(done)
        method = asked.methods[number % len(asked.methods)]
        name = troubles[(number + number // len(asked.methods)) % len(troubles)]
        if not (PLACE / f"{method}.json").exists():
            name = "none"  # what the others are held against
        done.append(calibrated(method, name, generator))
        with LINES.open("a") as file:
            file.write(json.dumps(done[-1]) + "\n")
        print(json.dumps(done[-1]), flush=True)
    lines = list(summary(done))
    left_out = sorted(set(TROUBLES) - set(troubles))
    print(*lines, f"left out here: {', '.join(left_out) or 'nothing'}", sep="\n")
    hours = sum(found["seconds"] for found in done) / 3600.0
    print(f"{len(done)} sessions in {hours:.2f} h")
    return 1 if any(line.startswith("wrong") for line in lines) else 0


if __name__ == "__main__":
    sys.exit(main())
