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

from rotcal_ros.adjust.closures import Closure
from rotcal_ros.adjust.gathering import Gathering, GatheringLimits
from rotcal_ros.adjust.gathering import doubts as doubt_gathering
from rotcal_ros.adjust.noise import GlobalTest
from rotcal_ros.foundation.results import ErrorMotion, Verdict
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.tracer.settings import TracerLimits
from rotcal_ros.methods.tracer.solver.problem import FREE_TARGET_MINIMUM
from rotcal_ros.methods.tracer_six.lengths.screening import WORDS as LENGTHS
from rotcal_ros.methods.tracer_six.lengths.screening import NoiseFactors
from rotcal_ros.methods.tracer.solver.uncertainty import CircleStatement
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
HARDLY_CHECKED: Final = 0.01
"""Share of a stated circle below which nothing would contradict it."""


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence(LengthEvidence):
    """What the verdict on stations of one circle rests on.

    ``missing`` are positions without a result, ``spare`` targets of a free network that too few
    lengths reach, ``fringe`` (m) is what a counter slips by.
    """

    circle: GlobalTest
    error_motion: ErrorMotion
    radial_rms: float
    closures: tuple[Closure, ...]
    missing: tuple[int, ...]
    spare: tuple[int, ...]
    mirror_ambiguous: bool
    circle_statement: CircleStatement | None = None
    fringe: float = 0.0


def judge(evidence: Evidence, settings: TracerLimits) -> tuple[Verdict, tuple[str, ...]]:
    """Return the verdict and its warnings by the rules in this module's docstring."""
    return judged(evidence, settings, _doubt_stations(evidence, settings), _remarks(evidence))


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


def _doubt_stations(evidence: Evidence, settings: TracerLimits) -> list[str]:
    doubts: list[str] = []
    doubts += [
        doubt_jump(f"segment {jump.segment}", jump, evidence.fringe) for jump in evidence.jumps
    ]
    doubts += [doubt_closure(c) for c in evidence.closures if c.open(settings.test_significance)]
    doubts += _doubt_circle(evidence, settings)
    motion = evidence.error_motion
    stated = motion.stated is not None and evidence.circle_statement is None
    if stated and evidence.circle.probability < settings.test_significance:
        doubts.append(
            f"the stations leave their circle by {evidence.radial_rms:.3g} m (rms), "
            f"{evidence.circle.sigma0:.1f} times what is expected: the table's radial error "
            f"motion is larger than the stated {motion.stated:.2g} m; {motion.used:.2g} m, from "
            f"{motion.dof} residuals of the circle, is used in its place"
        )
    if evidence.missing:
        names = ", ".join(str(j) for j in evidence.missing)
        doubts.append(f"no deviation for station(s) {names}: too few usable lengths")
    return doubts


def _doubt_circle(evidence: Evidence, settings: TracerLimits) -> list[str]:
    circle = evidence.circle_statement
    if circle is None or circle.probability >= settings.test_significance:
        return []
    return [
        f"the stations leave their circle, radially and axially, {circle.sigma0:.1f} times as far "
        f"as is expected ({circle.dof} contrasts that the lengths determine): the stated "
        f"circle_std of {circle.stated:.2g} m does not hold; {circle.used:.2g} m is used in its "
        "place"
    ]


def doubt_closure(closure: Closure) -> str:
    """Return the sentence about a closure that is larger than its uncertainty allows."""
    return (
        f"stations {closure.first} and {closure.last} stand at the same table angle but differ by "
        f"{closure.error / ARCSEC:.3g} arcsec, expected 0 with a standard deviation of "
        f"{closure.std / ARCSEC:.3g} arcsec: something moved or drifted during the run"
    )


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


def _remarks(evidence: Evidence) -> list[str]:
    remarks: list[str] = []
    if evidence.spare:
        names = ", ".join(str(i) for i in evidence.spare)
        remarks.append(
            f"target(s) {names} of the free network were left out: fewer than "
            f"{FREE_TARGET_MINIMUM} lengths reach them"
        )
    circle = evidence.circle_statement
    if circle is not None and circle.redundancy < HARDLY_CHECKED:
        remarks.append(
            f"the lengths check {100 * circle.redundancy:.2g} % of the stated circle: that the "
            "stations stand on it is believed, not measured"
        )
    if evidence.mirror_ambiguous:
        remarks.append(
            "all targets lie in one plane, so the tracer could stand on either side of it: the "
            "lower side was taken; give start_stations to choose the other"
        )
    return remarks


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
