"""Run a command as if of the packages beside the core only these were installed.

usage: python scripts/alone.py [PACKAGE ...] -- COMMAND ...

The others are hidden by a folder at the head of PYTHONPATH: metadata without entry points, which
count because they are found first, and modules that cannot be imported.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

PACKAGES = Path(__file__).resolve().parents[1] / "packages"


def hide(folder: Path, kept: Iterable[str] = ()) -> None:
    """Write into ``folder`` what hides all packages but those that are kept."""
    names = {path.parent.name for path in PACKAGES.glob("*/setup.py")}
    if unknown := {*kept} - names:
        raise SystemExit(f"alone: no package {min(unknown)!r} in {PACKAGES}")
    for name in sorted(names.difference(kept)):
        metadata = folder / f"{name}.egg-info"
        metadata.mkdir()
        (metadata / "PKG-INFO").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0\n")
        text = f"No module named {name!r}"
        (folder / f"{name}.py").write_text(f"raise ModuleNotFoundError({text!r}, name={name!r})\n")


def main() -> int:
    """Hide, run, and end as the command ends."""
    end = sys.argv.index("--")
    with tempfile.TemporaryDirectory(prefix="alone-") as folder:
        hide(Path(folder), sys.argv[1:end])
        path = os.pathsep.join([folder, *filter(None, [os.environ.get("PYTHONPATH")])])
        command = sys.argv[end + 1 :]
        return subprocess.run(command, env=os.environ | {"PYTHONPATH": path}).returncode


if __name__ == "__main__":
    sys.exit(main())
