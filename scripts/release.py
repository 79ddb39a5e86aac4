#!/usr/bin/env python3
"""Make a release: check, build, try and describe what goes out. docs/releasing.md explains it.

    make release                             # of a tagged, clean checkout, into out/release
    make release RELEASE_ARGS=--rehearse     # of any commit, however unfinished
    python scripts/release.py --set 1.0.1    # writes a version, and today, wherever they stand

Whatever is wrong ends it with a sentence and exit code 1, before anything stands in out/release.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime, timezone
from functools import partial
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
OUTPUT = ROOT / "out" / "release"
BESIDE = tuple(sorted(path.parent.name for path in ROOT.glob("packages/*/setup.py")))
"""The packages beside the core."""
MANIFESTS = (
    ROOT / "package.xml",
    ROOT / "msg_defs" / "package.xml",
    *(ROOT / "packages" / name / "package.xml" for name in BESIDE),
)
CHANGELOGS = tuple(path.with_name("CHANGELOG.rst") for path in MANIFESTS)
STATED = {
    ROOT / "rotcal_ros" / "__init__.py": r'^__version__ = "(.+)"$',
    ROOT / "pixi.toml": r'^version = "(.+)"$',
    **{ROOT / "packages" / name / "setup.py": r'^VERSION = "(.+)"$' for name in BESIDE},
    **dict.fromkeys(MANIFESTS, r"^  <version>(.+)</version>$"),
    **dict.fromkeys(CHANGELOGS, r"^(\d+\.\d+\.\d+) \(.+\)$"),
}
"""File -> the line that states the version; the first one counts."""
HEADING = re.compile(r"^\d+\.\d+\.\d+ \(.+\)\n-+$", re.MULTILINE)
PYTHONS = ("3.10", "3.11", "3.12", "3.13")
UNTRIED = "not on this machine"
UV = Path(sys.executable).with_name("uv")
"""Makes environments in seconds; the lock has it."""
GOLDEN = ROOT / "test" / "golden" / "tracer" / "table"
SPEAKS = """
import json, sys
stored, solved = (json.load(open(path)) for path in sys.argv[1:])
apart = [abs(a - b) for a, b in zip(*(r["deviations"]["ECC"] for r in (stored, solved)))]
assert solved["verdict"] == stored["verdict"], solved["verdict"]
assert max(apart) < 1e-12, f"deviations differ by {max(apart)} rad"
"""
LOADS = """
import sys
from importlib.metadata import distribution
for name in sys.argv[1:]:
    for point in distribution(name).entry_points:
        try:
            point.extras or point.load()
        except ModuleNotFoundError as error:
            of_ros = error.name == "rclpy" or error.name.endswith(("_msgs", "_interfaces"))
            assert of_ros, error
"""
README = ROOT / "README.md"
OF_README = {
    "out/demo/bag": "tracer_six/bag",
    "out/demo/result.json": "tracer_six/result.json",
    "out/second/result.json": "tracer_six/table/result.json",
    "out/ball_plate_demo/bag": "ball_plate/bag",
}
"""What the README's commands are given -> the golden file that stands in for it."""


class UnfitError(Exception):
    """Why this checkout cannot be released."""


def main() -> int:
    """Check, build, try, describe; print where it all is."""
    parser = argparse.ArgumentParser(description="Make a release.")
    parser.add_argument("--rehearse", action="store_true", help="of a commit that is no release")
    parser.add_argument("--set", metavar="VERSION", help="write this version and stop")
    asked = parser.parse_args()
    rehearsed = asked.rehearse
    try:
        if asked.set:
            set_version(asked.set)
            return 0
        version = agreed_version()
        if not rehearsed:
            check_finished(version)
        with tempfile.TemporaryDirectory(prefix="release-") as folder:
            built = release(version, Path(folder))
            shutil.rmtree(OUTPUT, ignore_errors=True)
            shutil.copytree(built, OUTPUT)
    except (UnfitError, subprocess.CalledProcessError) as reason:
        print(f"release: {reason}", file=sys.stderr)
        return 1
    print(f"{'rehearsal of ' if rehearsed else ''}rotcal_ros {version}: {OUTPUT}")
    return 0


def agreed_version() -> str:
    """Return the one version that package, manifests and changelogs state."""
    found = {p: re.search(line, p.read_text(), re.MULTILINE) for p, line in STATED.items()}
    versions = {_name(path): match[1] if match else "" for path, match in found.items()}
    if len(set(versions.values())) != 1:
        raise UnfitError("versions differ: " + ", ".join(f"{k} {v}" for k, v in versions.items()))
    return next(iter(versions.values()))


def set_version(version: str) -> None:
    """Write a version wherever one is stated, and the day into the changelogs."""
    for path in CHANGELOGS:
        newest, date = newest_heading(path)
        if newest != version and date != "unreleased":
            raise UnfitError(
                f"{_name(path)} begins with {newest} of {date}: begin a section "
                f"'{version} (unreleased)' there"
            )
    for path, line in STATED.items():
        if path not in CHANGELOGS:
            write = partial(_with_version, version=version)
            path.write_text(re.sub(line, write, path.read_text(), count=1, flags=re.MULTILINE))
    heading = f"{version} ({datetime.now(timezone.utc).date()})"
    for path in CHANGELOGS:
        whole = re.sub(HEADING, f"{heading}\n{'-' * len(heading)}", path.read_text(), count=1)
        path.write_text(whole)


def _with_version(line: re.Match[str], version: str) -> str:
    return line[0].replace(line[1], version)


def newest_heading(changelog: Path) -> tuple[str, str]:
    """Return version and date ("unreleased" before it has one) of a changelog's first section."""
    found = re.search(r"^(\d+\.\d+\.\d+) \((.+)\)$", changelog.read_text(), re.MULTILINE)
    if not found:
        raise UnfitError(f"{_name(changelog)} has no heading like '1.0.0 (2027-01-31)'")
    return found[1], found[2]


def check_finished(version: str) -> None:
    """Refuse what is not committed, not dated or not tagged."""
    if changed := _output("git", "status", "--porcelain"):
        raise UnfitError(
            f"not committed: {changed.splitlines()[0].strip()} ...; commit it or put it away"
        )
    for path in CHANGELOGS:
        date = newest_heading(path)[1]
        if not re.fullmatch(r"\d{4}-\d{2}-\d{2}", date):
            raise UnfitError(
                f"{_name(path)}: {version} is '{date}'; write the day of the release there"
            )
    if version not in _output("git", "tag", "--points-at", "HEAD").split():
        raise UnfitError(
            f"this commit is not tagged: git tag -a {version} -m 'rotcal_ros {version}'"
        )


def release(version: str, work: Path) -> Path:
    """Return the folder of all that goes out, after it was tried."""
    source, built = work / "source", work / "release"
    for folder in (source, built):
        folder.mkdir()
    commit = _output("git", "rev-parse", "HEAD").strip()
    _export(source, commit)
    beside = {name: source / "packages" / name for name in BESIDE}
    wheels, archives = zip(
        *(
            build_package(name, place, built, work)
            for name, place in {"rotcal_ros": source, **beside}.items()
        ),
        strict=True,
    )
    core, *others = wheels
    trials = {core.name: [core], archives[0].name: [archives[0]]}
    trials |= {wheel.name: [core, wheel] for wheel in others} | {"all wheels": wheels}
    tried = {
        f"{python} {what}": try_out(python, packages, work, built)
        for python in PYTHONS
        for what, packages in trials.items()
    }
    tried[f"{PYTHONS[0]} all wheels, oldest dependencies"] = try_out(
        PYTHONS[0], wheels, work, built, ("--resolution", "lowest-direct")
    )
    if not any(ok.startswith("passed") for ok in tried.values()):
        raise UnfitError(f"none of Python {', '.join(PYTHONS)} is on this machine")
    with tarfile.open(built / f"rotcal_msgs-{version}.tar.gz", "w:gz") as messages:
        messages.add(source / "msg_defs", f"rotcal_msgs-{version}")
    note = {"version": version, "commit": commit, "tried": tried}
    (built / "release.json").write_text(json.dumps(note, indent=2) + "\n")
    write_checksums(built)
    return built


def build_package(name: str, source: Path, built: Path, work: Path) -> tuple[Path, Path]:
    """Return the wheel and the source archive of a package, after a look at what they hold."""
    print(f"building {name}", flush=True)
    build = (sys.executable, "-m", "build", "--installer", "uv", "--quiet")
    _run(*build, "--outdir", built, source, cwd=work)
    wheel, archive = next(built.glob(f"{name}-*.whl")), next(built.glob(f"{name}-*.tar.gz"))
    check_contents(name, wheel, archive, source)
    return wheel, archive


def check_contents(name: str, wheel: Path, archive: Path, source: Path) -> None:
    """Refuse a wheel or a source archive that lacks a file of the package, or holds another."""
    of_package = {
        str(path.relative_to(source)) for path in (source / name).rglob("*") if path.is_file()
    }
    with zipfile.ZipFile(wheel) as stream:
        packed = {held for held in stream.namelist() if held.startswith(f"{name}/")}
    with tarfile.open(archive) as stream:
        names = {held.partition("/")[2] for held in stream.getnames()}
    for what, held in (("wheel", packed), ("source archive", names)):
        if missing := of_package - held:
            raise UnfitError(f"the {what} lacks {min(missing)} ({len(missing)} files)")
    if strange := packed - of_package:
        raise UnfitError(f"the wheel holds {min(strange)}, which the repository does not")


def try_out(
    python: str,
    packages: Sequence[Path],
    work: Path,
    built: Path,
    versions: Sequence[str | Path] = ("-c", ROOT / "constraints.txt"),
) -> str:
    """Install packages for one Python, alone, and solve with them; return how that went.

    ``versions`` tells uv which of each dependency; else those that are pinned.

    The first wheel that passes also gives the bill of materials.
    """
    interpreter = find_python(python)
    if interpreter is None:
        return UNTRIED
    print(f"Python {python}: {', '.join(package.name for package in packages)}", flush=True)
    begin, place = time.monotonic(), work / "try"
    shutil.rmtree(place, ignore_errors=True)
    _run(UV, "venv", "--quiet", "--no-project", "--python", interpreter, place)
    inside = place / "bin" / "python"
    _run(UV, "pip", "install", "--quiet", "--python", inside, *versions, *packages)
    program = place / "bin" / "rotcal"
    if "cannot be loaded" in _output(program, "--help", cwd=place):
        raise UnfitError(f"Python {python}: a verb cannot be loaded")
    _run(inside, "-c", LOADS, *(package.name.split("-")[0] for package in packages), cwd=place)
    solved = place / "solved.json"
    solve = (program, "solve", GOLDEN / "table.csv", "--setup", GOLDEN / "setup.yaml", "--json")
    solved.write_text(_output(*solve, cwd=place))
    _run(inside, "-c", SPEAKS, GOLDEN / "result.json", solved, cwd=place)
    if len(packages) == len(BESIDE) + 1:
        run_readme(place)
    bill = built / "sbom.cdx.json"
    if packages[0].suffix == ".whl" and not bill.exists():
        tool = Path(sys.executable).with_name("cyclonedx-py")
        _run(tool, "environment", "--output-reproducible", "-o", bill, inside)
    return f"passed in {time.monotonic() - begin:.0f} s"


def run_readme(place: Path) -> None:
    """Run what the README shows without ROS, with golden files in place of a demo's."""
    for name, golden in OF_README.items():
        source, target = ROOT / "test" / "golden" / golden, place / name
        target.parent.mkdir(parents=True, exist_ok=True)
        (shutil.copytree if source.is_dir() else shutil.copy)(source, target)
    shutil.copytree(ROOT / "examples" / "data", place / "examples" / "data")
    for words in readme_commands(README.read_text()):
        _run(place / "bin" / words[0], *words[1:], cwd=place)


def readme_commands(text: str) -> Iterator[list[str]]:
    """Yield the commands and the lines of Python, those without ROS."""
    for line in re.findall(r"^    (rotcal (?!run|doctor).+)$", text, re.MULTILINE):
        yield line.partition("#")[0].split()
    lines = re.findall(r"^    ((?:import|result|print).+)$", text, re.MULTILINE)
    yield ["python", "-c", "\n".join(lines)]


def find_python(version: str) -> str | None:
    """Return the path of a Python, on the path or of pyenv; None: there is none."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    here = sorted(pyenv.glob(f"versions/{version}.*/bin/python"))
    on_path = shutil.which(f"python{version}")
    for candidate in [*([on_path] if on_path else []), *map(str, here)]:
        asked = [candidate, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
        answer = subprocess.run(asked, capture_output=True, text=True, check=False)
        if answer.stdout.strip() == version:
            return candidate
    return None


def write_checksums(folder: Path) -> None:
    """Write SHA256SUMS, as `sha256sum --check` reads it."""
    lines = [
        f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n"
        for path in sorted(folder.iterdir())
    ]
    (folder / "SHA256SUMS").write_text("".join(lines))


def _export(target: Path, commit: str) -> None:
    """Copy what a commit holds, and nothing else, into a folder."""
    archive = subprocess.run(
        ("git", "archive", commit), cwd=ROOT, check=True, stdout=subprocess.PIPE
    ).stdout
    subprocess.run(("tar", "-x", "-C", target), input=archive, check=True)


def _run(*command: str | Path, cwd: Path = ROOT) -> None:
    _output(*command, cwd=cwd)


def _output(*command: str | Path, cwd: Path = ROOT) -> str:
    """Return what a command prints; what it complains about ends the release."""
    words: Sequence[str] = [str(word) for word in command]
    done = subprocess.run(
        words, cwd=cwd, env=_environment(), capture_output=True, text=True, check=False
    )
    if done.returncode:
        last = (done.stderr or done.stdout).strip().splitlines()[-8:]
        raise UnfitError(f"{' '.join(words[:4])} ... failed:\n  " + "\n  ".join(last))
    return done.stdout


def _environment() -> dict[str, str]:
    """Return the environment without what points at other Pythons and at this checkout."""
    hidden: Iterable[str] = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "AMENT_PREFIX_PATH")
    kept = {name: text for name, text in os.environ.items() if name not in hidden}
    if "PIP_CERT" in os.environ:  # as scripts/setup.sh
        kept["SSL_CERT_FILE"] = os.environ["PIP_CERT"]
    return kept | {"OMP_NUM_THREADS": "1"}


def _name(path: Path) -> str:
    return str(path.relative_to(ROOT))


if __name__ == "__main__":
    sys.exit(main())
