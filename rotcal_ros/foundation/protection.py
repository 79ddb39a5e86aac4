"""How a calibration treats each effect that could spoil it.

A small sigma0 proves nothing about an effect that the residuals cannot show. So every method
states, effect by effect, whether it is estimated, tested, bounded by a statement, harmless, or
*not protected*; the verdict is never shown without the last of these, in the line below it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Literal, get_args

from rotcal_ros.foundation.language import Phrase, noted, phrase

Common = Literal[
    "drift",
    "knock",
    "axis noise",
    "error motion",
    "repeatability",
    "refraction",
    "scale",
    "tilt",
    "gauge",
]
Particular = Literal[
    "growth",
    "slip",
    "tangential motion",
    "uneven drift",
    "recurring drift",
    "one place",
    "single readings",
    "numbering",
    "sign of z",
    "sign of readings",
    "sense",
    "gain",
    "polygon tilt",
    "probe tip",
    "lag",
    "straightness",
    "play",
]
Effect = Literal[Common, Particular]
PARTICULAR: Final[tuple[Effect, ...]] = get_args(Particular)
"""Effects that only those methods list whose instruments have them: an artefact that warms and
grows while it is measured; counted fringes, or a reference that does not turn as the table does;
an instrument on the table, which its mount or cable may shift along its circle; one that drifts
between two measurements of its nests; a drift that comes back with each run; an error that gathers
in one place among many; readings that no other checks; table positions or set-ups that are
numbered wrong; a z axis that points down, and readings of the other sign, where no measurement
would show it; a table that turns the other way than is stated; an instrument that shows too much
or too little; a polygon or another reference that leans against the axis; the offset of a probe's
tip; readings that are late beside the angle of a table that turns; linear axes that do not go
straight, and what they lose where they turn."""
ALL_EFFECTS: Final[tuple[Effect, ...]] = get_args(Effect)
"""All effects, in the order of display."""
EFFECTS: Final[tuple[Effect, ...]] = get_args(Common)
"""Effects that every method lists."""
Treatment = Literal["estimated", "tested", "bounded", "harmless", "not protected"]
TREATMENTS: Final[tuple[Treatment, ...]] = get_args(Treatment)

POWER: Final = 0.95
"""A test protects against effects that it finds with this probability."""
TOLERABLE: Final = 2.0
"""Error, in stated standard uncertainties, that may stay unseen without being named."""


@dataclass(frozen=True, slots=True)
class Protection:
    """What is done about one effect, and why that is enough or is not.

    ``estimated``: a parameter of the fit, its uncertainty is part of the result. ``tested``: a
    size that matters changes the verdict with a probability of POWER. ``bounded``: the uncertainty
    contains a stated allowance. ``harmless``: it cannot touch the deviations. ``error`` is the
    largest error that it causes where the test begins to find it with POWER, in stated standard
    uncertainties; None if that is not known or does not apply.
    """

    effect: Effect
    treatment: Treatment
    why: Phrase
    error: float | None = None

    def __post_init__(self) -> None:
        """Refuse unknown effects and treatments; raises ValueError."""
        if self.effect not in ALL_EFFECTS:
            raise ValueError(f"effect {self.effect!r}: expected one of {', '.join(ALL_EFFECTS)}")
        if self.treatment not in TREATMENTS:
            raise ValueError(
                f"treatment {self.treatment!r}: expected one of {', '.join(TREATMENTS)}"
            )


def unprotected(protections: Iterable[Protection]) -> tuple[Effect, ...]:
    """Return the effects against which there is no protection, in the order of ALL_EFFECTS.

    A tested effect that may cause more than TOLERABLE before it is found counts among them.
    """
    bare = {
        p.effect
        for p in protections
        if p.treatment == "not protected"
        or (p.treatment == "tested" and p.error is not None and p.error > TOLERABLE)
    }
    return tuple(effect for effect in ALL_EFFECTS if effect in bare)


BOTH_LINES: Final = noted("{0}. Not tested for: {1}")
"""A verdict, never without what it does not cover."""


def coverage_note(missing: str) -> str:
    """Return the line below a verdict, which names what is ``missing``; empty for nothing."""
    return phrase("Not tested for: {0}", missing) if missing else ""


def split_verdict_line(verdict_line: str) -> tuple[str, str]:
    """Return the verdict and what it does not cover, of both as one text."""
    if isinstance(verdict_line, Phrase) and verdict_line.template == BOTH_LINES:
        found, missing = map(str, verdict_line.parts)
        return found, coverage_note(missing)
    words, mark, rest = verdict_line.partition(". Not tested for: ")
    return words, coverage_note(rest if mark else "")


def ordered(protections: Iterable[Protection]) -> tuple[Protection, ...]:
    """Return the protections in the order of ALL_EFFECTS; raises ValueError for a second one."""
    by_effect: dict[Effect, Protection] = {}
    for protection in protections:
        if protection.effect in by_effect:
            raise ValueError(f"the effect {protection.effect!r} is stated twice")
        by_effect[protection.effect] = protection
    return tuple(by_effect[effect] for effect in ALL_EFFECTS if effect in by_effect)
