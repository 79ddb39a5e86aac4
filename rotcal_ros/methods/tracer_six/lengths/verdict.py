"""ok, suspect or failed: the rules, and the sentences that say why.

suspect
    a component of the noise is larger than stated (:mod:`.screening`; the estimate is used), or
    the chi-squared test of the lengths fails all the same (the covariance is then enlarged by
    sigma0^2); more than ``max_rejected_share`` of the lengths were rejected; some lengths of one
    station or stretch of time are off together, or look like it; a station, target or stretch lost
    more lengths than chance explains, or has too large a chi-squared (:mod:`.screening`); a
    closure is larger than its uncertainty allows; the stations leave the circle by more than the
    stated error motion (the estimate of :mod:`.uncertainty` is used) or by more than the stated
    circle allows (what they leave of it is used); a zero jumps within a segment of
    unbroken beam (:mod:`.zeros`; it is split); or a position of the plan is missing.
failed
    the lengths scatter more than 10 times or the targets more than 30 times as stated (the model
    does not describe the data), or more than a fifth of the lengths were rejected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from rotcal_ros.adjust.gathering import Gathering, GatheringLimits
from rotcal_ros.adjust.gathering import doubts as doubt_gathering
from rotcal_ros.adjust.noise import GlobalTest
from rotcal_ros.foundation.results import Verdict
from rotcal_ros.methods.tracer.settings import TracerLimits
from rotcal_ros.methods.tracer_six.lengths.screening import WORDS as LENGTHS
from rotcal_ros.methods.tracer_six.lengths.screening import NoiseFactors
from rotcal_ros.methods.tracer_six.lengths.zeros import Jump

FAILED_FACTORS: Final = np.array([10.0, 10.0, 30.0, 30.0, 30.0])
"""Times the stated noise of each component of :mod:`.screening`."""
WORDS: Final = (
    "the scatter of the lengths",
    "the part of the lengths' scatter that grows with the distance",
    "the targets' x",
    "the targets' y",
    "the targets' z",
)
FAILED_SHARE: Final = 0.2
"""Share of rejected lengths beyond which the rest is not believed either."""
NOISY: Final = 2.0
"""Times the stated noise from which the middle half of all residuals is no matter of outliers."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LengthEvidence:
    """What the verdict on any network of lengths rests on.

    ``lengths``: test against the noise as stated, ``unexplained``: what the estimated ``noise``
    leaves, as a factor. ``scatter``: by how much all residuals, those of rejected lengths too,
    exceed what is stated. ``n_lengths`` could have been used, ``n_rejected`` of them were not;
    ``unchecked`` are without redundancy. ``gathering``: what was found in one place; ``jumps`` of
    zeros.
    """

    lengths: GlobalTest
    noise: NoiseFactors
    unexplained: float
    n_lengths: int
    n_rejected: int
    unchecked: int
    scatter: float = 1.0
    gathering: Gathering = field(default_factory=Gathering)
    jumps: tuple[Jump, ...] = ()


def judged(
    evidence: LengthEvidence,
    settings: TracerLimits,
    doubts: Sequence[str],
    remarks: Sequence[str] = (),
) -> tuple[Verdict, tuple[str, ...]]:
    """Return verdict and warnings of any network of lengths, with a method's own doubts."""
    usual = GatheringLimits(settings.max_rejected_share, settings.test_significance)
    doubts = [
        *_doubt_noise(evidence.noise, settings),
        *_doubt_residuals(evidence.unexplained),
        *_doubt_rejected(evidence, settings),
        *doubt_gathering(evidence.gathering, usual, LENGTHS),
        *doubts,
    ]
    factors = evidence.unexplained * evidence.noise.factors
    verdict: Verdict = "suspect" if doubts else "ok"
    if (factors > FAILED_FACTORS).any() or evidence.n_rejected / evidence.n_lengths > FAILED_SHARE:
        verdict = "failed"
    unchecked = evidence.unchecked
    if unchecked:
        remarks = [
            *remarks,
            f"{unchecked} lengths are checked by no other: an error in them stays unseen",
        ]
    return verdict, (*doubts, *_remark_noise(evidence.noise, settings), *remarks)


def _doubt_residuals(unexplained: float) -> list[str]:
    if unexplained <= 1.0:
        return []
    return [
        f"the residuals of the lengths are {unexplained:.2f} times what their standard deviations "
        "allow (chi-squared test): the uncertainty is enlarged by that factor; look for drift or "
        "a tracer that slips on the table, or state larger standard deviations"
    ]


def _doubt_noise(noise: NoiseFactors, settings: TracerLimits) -> list[str]:
    """Return a sentence for every component of the noise that is larger than stated."""
    larger = noise.contradicted(settings.test_significance) & (noise.factors > 1.0)
    return [
        f"{_times_stated(noise, k)}: the estimate is used; {_advice(noise, k)}"
        for k in np.flatnonzero(larger).tolist()
    ]


def _advice(noise: NoiseFactors, k: int) -> str:
    """Return what to do about a component that is larger than stated."""
    if k:
        return "state it, or look for drift"
    return (
        f"state what a length scatters by, {noise.factors[0] * noise.stated[0]:.2g} m, in "
        "solver.length_std_m (for single readings all of their noise), or look for drift"
    )


def _doubt_rejected(evidence: LengthEvidence, settings: TracerLimits) -> list[str]:
    """Return a sentence when more lengths were rejected than the settings allow.

    Where all residuals scatter the noise is named, not single targets.
    """
    n_rejected, n_lengths = evidence.n_rejected, evidence.n_lengths
    share = n_rejected / n_lengths
    if share <= settings.max_rejected_share:
        return []
    cause = "look for a target with wrong coordinates, or an unstable beam"
    if evidence.scatter > NOISY:
        cause = (
            f"the residuals of all lengths, the rejected ones too, scatter {evidence.scatter:.2g} "
            "times as stated: that is noise and no outliers; raise solver.length_std_m (for "
            "single readings all of their noise)"
        )
    return [
        f"{n_rejected} of {n_lengths} lengths ({100 * share:.1f} %) were rejected, more than "
        f"{100 * settings.max_rejected_share:g} % is suspicious: {cause}"
    ]


def doubt_jump(where: str, jump: Jump, fringe: float) -> str:
    """Return the sentence about a zero that jumped; ``fringe`` (m) is what a counter slips by."""
    return (
        f"the zero of {where} jumps by {jump.size:+.3g} m (standard deviation {jump.std:.2g} m) "
        f"at observation {jump.row}, although no break was reported: {_cause(jump, fringe)}; it "
        "was split there"
    )


def _cause(jump: Jump, fringe: float) -> str:
    """Return what may have made a zero jump."""
    if number := jump.fringes(fringe):
        return f"as much as {number:+d} fringe(s), a counter that slipped"
    return "a beam that was broken, or a tracer that was knocked"


def _remark_noise(noise: NoiseFactors, settings: TracerLimits) -> list[str]:
    """Return a sentence for every component whose estimate is used, and is no reason to doubt."""
    doubted = noise.contradicted(settings.test_significance)
    return [
        f"{_times_stated(noise, k)}, and so the estimate is used"
        for k in np.flatnonzero(noise.contradicted(settings.noise_significance)).tolist()
        if noise.factors[k] < 1.0 or not doubted[k]
    ]


def _times_stated(noise: NoiseFactors, k: int) -> str:
    """Return how many times its statement component ``k`` is, in words."""
    return f"{WORDS[k]} is {noise.factors[k]:.2g} times its stated {noise.stated[k]:.2g} m"
