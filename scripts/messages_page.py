"""Makes docs/messages.md: messages, services and the action, as they are defined in msg_defs."""

from __future__ import annotations

from pathlib import Path

DEFINITIONS = Path(__file__).resolve().parents[1] / "msg_defs"
HEAD = """# Messages, services, action

Package `rotcal_msgs`, as in `msg_defs/`. Topics and services: [interfaces](interfaces.md);
signs and frames: [conventions](conventions.md).
"""
KINDS = {"msg": "Messages", "srv": "Services", "action": "Action"}


def page() -> str:
    """Return the page."""
    return HEAD + "".join(map(_section, KINDS))


def _section(kind: str) -> str:
    files = sorted((DEFINITIONS / kind).glob(f"*.{kind}"))
    blocks = (f"\n### {p.stem}\n\n```\n{p.read_text('utf-8').strip()}\n```\n" for p in files)
    return f"\n## {KINDS[kind]}\n{''.join(blocks)}"


if __name__ == "__main__":
    print(page(), end="")
