"""docs/interfaces.md names every interface; the parameters stand in docs/settings.md."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "interfaces.md").read_text(encoding="utf-8")


def test_every_interface_and_error_code_stands_there():
    names = {p.stem for p in (ROOT / "msg_defs").glob("*/*.*") if p.suffix in (".msg", ".srv")}
    assert {n for n in names if n not in PAGE} == set()
    action = (ROOT / "msg_defs" / "action" / "Calibrate.action").read_text()
    for line in action.splitlines():
        if line.startswith("uint16 ") and "=" in line:
            name, code = line.split()[1].split("=")
            assert f"| {code} `{name}` |" in PAGE
