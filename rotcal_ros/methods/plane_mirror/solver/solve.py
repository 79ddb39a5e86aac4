"""The plane-mirror calibration: a frozen problem in, the angular deviations out.

:func:`solve` adjusts the model of the points by the engine. Where a way of the paper is chosen
the deviations are those of its equations (:mod:`.printed`), and what is said of them follows from
the same model (:mod:`rotcal_ros.adjust.mapped`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust.closures import Closure, closures
from rotcal_ros.adjust.distributions import chi2_sf, normal_isf
from rotcal_ros.adjust.engine import Adjusted, Trials, adjust
from rotcal_ros.adjust.mapped import MappedFit, with_other_outputs
from rotcal_ros.adjust.model import CurveModel
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.language import Phrase, noted, phrase
from rotcal_ros.foundation.protection import POWER, Protection
from rotcal_ros.foundation.results import FreeDirection, Rejection, Residuals, Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE, MILLIMETRE
from rotcal_ros.methods.added_errors import with_steps
from rotcal_ros.methods.plane_mirror.settings import DIRECT, JOINT, WAYS
from rotcal_ros.methods.plane_mirror.solver import printed
from rotcal_ros.methods.plane_mirror.solver.model import (
    NEST_MOVED,
    PARTS,
    TrackerModel,
    curve_model,
    spans_of,
    tied_positions,
)
from rotcal_ros.methods.plane_mirror.solver.problem import (
    Nests,
    PlaneMirrorProblem,
    PointLayout,
    Reflectors,
)
from rotcal_ros.methods.plane_mirror.solver.set_up import (
    incidence,
    joining_nests,
    lay_out_points,
    require_angles,
)

STATED_SWING: Final = noted(
    "by the stated swing of the tracker's azimuth of {0:g} arcsec (uneven_drift_std_arcsec) "
    "about the straight line between rounds of nests"
)
NOT_MEASURED_AGAIN: Final = noted(
    "the nests were not measured again before the tracker left station {0}, so what it turned by "
    "while it stood there is in the deviations"
)
UNSEEN_DRIFT: Final = noted(
    "what the tracker turns by between two rounds of nests and back again leaves no trace; 1 "
    "arcsec of it moves a deviation by up to {0:.2g} standard uncertainties: let it settle, and "
    "measure the nests more often (plan.nests_every)"
)
STOOD_ELSEWHERE: Final = noted("nest {0} stood elsewhere at station {1}")
AS_PRINTED: Final = noted(
    "the way {0}, as printed, takes no drift of the tracker into account, which moves deviations "
    "by up to {1:.2f} arcsec: the uncertainty holds it; choose joint"
)
MOVED_BETWEEN_ROUNDS: Final = noted(
    "tracker station {0} moved between rounds of nests (azimuth {1:.1f}, tilts {2:.1f} and "
    "{3:.1f} arcsec, range {4:.1f} um), which moves deviations by up to {5:.1f} standard "
    "uncertainties; it is taken away as linear in time, but a knock or a bend would stay: let "
    "the tracker settle, or measure the nests more often (plan.nests_every)"
)
REPEATS_DIFFER: Final = noted(
    "positions commanded to {0:g} and {1:g} deg differ by {2:.2f} arcsec, expected within "
    "{3:.2f}: the table does not repeat, or mirror or tracker moved"
)

METHOD: Final = "plane_mirror"
UNTIED: Final = phrase("table positions that share no reflector")
MAX_DEVIATION: Final = 1.0 * DEGREE
"""No rotary table is this wrong; a commanded angle or a nest is."""
LARGE: Final = 1.0
"""A drift from round to round may move a deviation by so many of its standard uncertainties."""
SEATED: Final = 8.0
"""Standard deviations that a badly seated reflector is off at least."""
KNOCK: Final = 4.0
"""A knock leaves up to this many times what the drift moved, found by simulation."""


def solve(problem: PlaneMirrorProblem) -> Result:
    """Return the angular deviation ECC of the table at every position, with covariance.

    Deviations are actual - commanded, counter-clockwise about the axis whose sense the commanded
    angles give, and zero at the first position (no method knows that offset). The paper,
    Muralikrishnan et al., "A Method to Calibrate Angular Positioning Errors Using a Laser Tracker
    and a Plane Mirror", prints commanded - measured (equations 6 to 19): the opposite sign.

    Raises DataError, GeometryError (see :mod:`.set_up`), ObservabilityError.
    """
    return MirrorSolution.of(problem).result()


def mirror_trials(problem: PlaneMirrorProblem) -> Trials:
    """Prepare Monte Carlo trials about a measured problem; refuses what ``solve`` refuses."""
    return MirrorSolution.of(problem).found.trials


def curves(problem: PlaneMirrorProblem) -> tuple[CurveModel, Ints]:
    """Return the points over ECC, to be solved with others, and the positions (n,) they have."""
    layout = lay_out_points(problem)[0]
    return curve_model(layout), layout.positions


def check_nests(
    problem: PlaneMirrorProblem, *, newest: bool = False, drift_limit: float = np.inf
) -> list[Phrase]:
    """Return what moved among the nests measured so far, in words; empty when all is well.

    For use while measuring: ``problem`` needs NEST rows only, and the others where nests were
    measured again to show the drift. ``newest``: only what the newest rounds of nests show.
    ``drift_limit`` (rad) is how far the tracker may turn there between two rounds. Raises
    DataError and GeometryError as :func:`solve`.
    """
    nests, _ = joining_nests(replace(problem, way=JOINT))
    if not len(nests.row):
        return []
    none = np.zeros(0, dtype=np.int64)
    nothing = Reflectors(none, none, none, none, none)
    layout = PointLayout(problem, none, np.zeros(0), None, nothing, nests, tied=True)
    tracker, last = TrackerModel.of(layout), int(problem.station.max())
    found = adjust(tracker.model(), tracker.limits)
    solution = MirrorSolution(layout, tracker, found, found, JOINT, (), ())
    asked = np.unique(nests.round)
    if newest:
        own = np.unique(nests.round[nests.station == last])
        asked = own[-max(len(own) - 1, 1) :]
    drift, own = solution.drift, solution.drift.stations == last
    turned = np.linalg.norm(drift.change[own, :3], axis=1).max(initial=0.0)
    moved = [(text, nests.round[later].min()) for text, later in solution.moved_nests]
    every = (*moved, *solution.badly_seated)
    texts = [text for text, begins in every if begins in asked]
    if turned > drift_limit and drift.probability(last) < problem.significance:
        texts.append(
            phrase(
                "the tracker turned by {0:.1f} arcsec between two rounds of nests at "
                "station {1}, allowed {2:g}: let it settle",
                turned / ARCSEC,
                problem.station_name(last),
                drift_limit / ARCSEC,
            )
        )
    return texts


@dataclass(frozen=True, eq=False)
class MirrorSolution:
    """The adjusted model of a layout, what its ``way`` has ``found``, and what is said of it."""

    layout: PointLayout
    tracker: TrackerModel
    joint: Adjusted
    found: Adjusted
    way: str
    rejected: tuple[Rejection, ...]
    doubts: tuple[Phrase, ...]

    @classmethod
    def of(cls, problem: PlaneMirrorProblem) -> MirrorSolution:
        """Solve a problem in its way."""
        layout, rejected, doubts = lay_out_points(problem)
        tracker = TrackerModel.of(layout)
        found = adjust(tracker.model(), tracker.limits)
        solution = cls(layout, tracker, found, found, JOINT, rejected, doubts)
        return solution.by_way(problem.way)

    def by_way(self, way: str) -> MirrorSolution:
        """Return the same by another way, without the elements that were left out.

        Raises DataError or GeometryError where the points do not serve it.
        """
        if way == JOINT:
            return replace(self, found=self.joint, way=way)
        tracker, found = self.tracker, self.joint
        layout = replace(self.layout, nests=self.split_nests).without(self.lost)
        require_angles(layout, way)
        value = printed.deviation_curve(layout, way, layout.problem.xyz)
        order = np.argsort(self.layout.rows)
        kept = order[np.searchsorted(self.layout.rows, layout.rows, sorter=order)]
        by = np.zeros((len(value), *tracker.root.shape[:2]))
        influence = printed.curve_derivative(layout, way, layout.rows)
        by[:, kept] = np.einsum("omj,mjk->omk", influence, np.linalg.inv(tracker.root[kept]))
        n, count = len(found.model.observed), by[0].size
        whole = np.zeros((len(value), n))
        whole[:, :count] = by.reshape(len(value), -1)
        return replace(self, found=with_other_outputs(found, value, whole), way=way)

    @cached_property
    def lost(self) -> Ints:
        """The elements of which the engine left out any row."""
        count = 3 * len(self.tracker.root)
        return np.unique([row // 3 for row in self.found.why if row < count]).astype(np.int64)

    @cached_property
    def std(self) -> Floats:
        """Standard uncertainties (N,) of the deviations, rad."""
        return self.found.std

    @cached_property
    def repeats(self) -> tuple[Closure, ...]:
        """What should agree: positions at one angle, from the same side."""
        layout, upward = self.layout, self.layout.problem.upward
        side = None if upward is None else upward[layout.positions]
        each = np.arange(len(layout.angles))
        return closures(layout.angles, self.found.value, self.found.covariance, each, side)

    @cached_property
    def whole_turn(self) -> dict[str, float]:
        """How far the table is from its first place after a whole turn, if it was measured."""
        for c in self.repeats:
            if abs(turned := self.layout.angles[c.last] - self.layout.angles[c.first]) > np.pi:
                sense = float(np.sign(turned))
                return {"closure_rad": sense * c.error, "closure_std_rad": c.std}
        return {}

    @property
    def others(self) -> list[str]:
        """The other ways that the paper or the engine has for these points."""
        mirror = self.layout.pairs is not None
        return [
            way for way in WAYS if way != self.way and (way == JOINT or (way == DIRECT) != mirror)
        ]

    def result(self) -> Result:
        """Return the result."""
        layout, problem, found = self.layout, self.layout.problem, self.found
        check_size(problem, layout.angles, found.value)
        rows = layout.rows
        seated = [text for text, _ in self.badly_seated]
        doubts = [*self.doubts, *seated, *self.drift.doubts, *self.left_out,
                  *differing(self.repeats, layout.angles, problem.significance)]  # fmt: skip
        every = found.result(
            METHOD,
            layout.angles,
            {"ECC": slice(0, len(layout.angles))},
            (problem.position[rows], problem.nest[rows]),
            coordinates=3,
            doubts=doubts,
            protections=tuple(self._protections()),
            details=self._details(),
            joint=True,
            further=False,
        )
        direct = layout.pairs.direct.tolist() if layout.pairs else []
        partner = dict(zip(rows.tolist(), direct, strict=False))
        left = [
            Rejection(row, r.why)
            for r in every.rejected
            for row in (int(rows[r.index]), partner.get(int(rows[r.index])))
            if row is not None
        ]
        residuals = every.residuals
        assert residuals is not None
        zeros = "first angle of each group" if self._free else "first angle"
        result = replace(
            every,
            n_observations=len(problem.xyz),
            rejected=(*self.rejected, *sorted(left, key=lambda r: r.index)),
            residuals=self._residuals(residuals),
        )
        return with_steps(result).counted_from(zeros, self._free)

    @property
    def _free(self) -> tuple[FreeDirection, ...]:
        """The offsets of positions that no reflector ties together; a mirror ties all."""
        label = printed.connected_islands(*tied_positions(self.layout), len(self.layout.angles))[0]
        return tuple(
            FreeDirection(UNTIED, {"ECC": (label == own).astype(np.float64)})
            for own in range(1, int(label.max()) + 1)
        )

    def _residuals(self, of_elements: Residuals) -> Residuals:
        """Return the residuals of all points; a pair's by what each point took of it."""
        layout, problem, tracker = self.layout, self.layout.problem, self.tracker
        n, rows = len(problem.xyz), layout.rows
        found = Residuals(
            table_position=problem.position.copy(),
            target=problem.nest.copy(),
            residual=np.zeros(n),
            redundancy=np.zeros(n),
            test_value=np.zeros(n),
            used=np.zeros(n, dtype=np.bool_),
            std=np.sqrt(np.trace(problem.noise.covariance(problem.xyz), axis1=1, axis2=2) / 3.0),
            coordinates=3,
        )
        points = [(rows, np.arange(len(rows)), np.tile(np.eye(3), (len(rows), 1, 1)))]
        if layout.pairs is not None:
            points.append((layout.pairs.direct, np.arange(tracker.pairs), tracker.reflection))
        e = np.linalg.solve(
            tracker.root, self.found.fit.residual[: rows.size * 3].reshape(-1, 3, 1)
        )
        for here, elements, reflected in points:
            own = problem.noise.covariance(problem.xyz[here]) @ reflected
            pull = own @ np.linalg.inv(tracker.covariance[elements])
            found.residual[here] = np.linalg.norm((pull @ e[elements])[:, :, 0], axis=1)
            share = np.trace(pull @ reflected, axis1=1, axis2=2) / 3.0
            found.redundancy[here] = np.clip(share * of_elements.redundancy[elements], 0.0, 1.0)
            found.test_value[here] = np.abs(of_elements.test_value[elements])
            found.used[here] = of_elements.used[elements]
        return found

    def _details(self) -> dict[str, Any]:
        layout, tracker, x = self.layout, self.tracker, self.found.fit.x
        problem = layout.problem
        again = [
            {"first": c.first, "second": c.last, "difference_rad": c.error, "std_rad": c.std}
            for c in self.repeats
        ]
        found: dict[str, Any] = {
            "way": self.way, "axis": tracker.frame(x)[:, 2], "repeats": again,
            **self.whole_turn, **self.drift.details,
        }  # fmt: skip
        if problem.upward is not None:
            found["table_positions"] = layout.positions
        poses, names = tracker.poses(x), problem.station_name
        if layout.tied and len(layout.nests.row):
            found["stations"] = [
                {"station": names(s), "position_m": poses.place[s], "rotation": poses.rotation[s]}
                for s in layout.stations
            ]
            found["nests"] = self._nests()
        if layout.pairs is None:
            q = tracker.start.reflectors + x[tracker.part["reflector"]].reshape(-1, 3)
            found["radii_m"] = [float(r) for r in np.hypot(*q[:, :2].T)]
            return found
        pairs = layout.pairs
        angle = incidence(problem, pairs)
        steepest = np.maximum.reduceat(angle, pairs.start)
        normals = printed.mean_normals(problem.xyz, pairs)
        return found | {
            "lean_rad": tracker.start.lean + float(x[tracker.part["lean"]][0]),
            "tilts_rad": x[tracker.part["tilt across"]],
            "incidence_limit_rad": problem.incidence_limit,
            "normals": [
                {
                    "angle_rad": layout.angles[pairs.position[g]],
                    "station": names(int(pairs.station[g])),
                    "incidence_rad": steepest[g],
                    "normal": normals[g],
                }
                for g in range(pairs.n_groups)
            ],
        }

    def _nests(self) -> list[dict[str, Any]]:
        layout, problem, fit = self.layout, self.layout.problem, self.found.fit
        nests, poses = layout.nests, self.tracker.poses(fit.x)
        placed = poses.placed(problem.xyz[nests.row], nests.station)
        part = slice(3 * self.tracker.pairs, 3 * len(layout.rows))
        residual = self._off(np.arange(len(nests.row)))
        test = np.sqrt((fit.test_value[part].reshape(-1, 3) ** 2).mean(axis=1))
        return [
            {
                "nest": nests.name[nests.point[q]],
                "station": problem.station_name(int(nests.station[q])),
                "position_m": placed[q],
                "residual_m": residual[q],
                "test_value": test[q],
            }
            for q in range(len(nests.row))
        ]

    @cached_property
    def moved_nests(self) -> list[tuple[Phrase, Bools]]:
        """In words, which nests moved for good, each with the readings (Q,) that show it."""
        taken = [e for e in self.joint.diagnosis.nuisance if e.effect is not None]
        part = slice(3 * self.tracker.pairs, 3 * len(self.layout.rows))
        found = list[tuple[Phrase, Bools]]()
        for effect, seen in zip(taken, self.joint.found_effects, strict=True):
            if seen.effect.what == NEST_MOVED:
                touched = effect.columns[part].reshape(len(self.layout.nests.row), -1) != 0.0
                found.append(
                    (phrase("it looks as if {0}", seen.describe()), np.any(touched, axis=1))
                )
        return found

    @property
    def split_nests(self) -> Nests:
        """The nests, of which one that moved is another one afterwards."""
        nests = self.layout.nests
        for _, later in self.moved_nests:
            own = later & (nests.point == nests.point[np.flatnonzero(later)[0]])
            point, name = nests.point.copy(), nests.name[nests.point[own][0]]
            point[own] = len(nests.name)
            nests = replace(nests, point=point, name=np.append(nests.name, name))
        return nests

    @cached_property
    def badly_seated(self) -> list[tuple[Phrase, int]]:
        """In words, which readings of nests were left out, each with its round."""
        nests, problem = self.layout.nests, self.layout.problem
        found = list[tuple[Phrase, int]]()
        for element in self.lost[self.lost >= self.tracker.pairs].tolist():
            k = element - self.tracker.pairs
            station = problem.station_name(int(nests.station[k]))
            size = float(np.linalg.norm(self._off(np.array([k])))) / MILLIMETRE
            if size * MILLIMETRE < SEATED * float(self.tracker.std[element].max()):
                continue  # no more than one reading of many that chance takes far off
            text = phrase(STOOD_ELSEWHERE, nests.name[nests.point[k]], station)
            mine = nests.point == nests.point[k]
            if (nests.station[mine] == nests.station[k]).sum() > 1:
                text = phrase("{0} in one of its rounds", text)
            what = phrase("{0} (by {1:.3f} mm); it is left out there", text, size)
            # of two readings either may be wrong: the later one shows it
            rounds = nests.round[mine]
            found.append((what, int(rounds.max() if mine.sum() == 2 else nests.round[k])))
        return found

    def _off(self, which: Ints) -> Floats:
        """Return how far readings (k,) of nests are from these (k, 3), m, along common axes."""
        at, nests = self.tracker.pairs + which, self.layout.nests
        fit = self.found.fit
        rows = fit.residual[: 3 * len(self.layout.rows)].reshape(-1, 3, 1)
        own = np.asarray(np.linalg.solve(self.tracker.root[at], rows[at])[:, :, 0])
        return self.tracker.poses(fit.x).turned(own, nests.station[which])

    @cached_property
    def left_out(self) -> list[Phrase]:
        """In words, what a printed way leaves out that matters."""
        fit, std = self.found.fit, self.std
        if not isinstance(fit, MappedFit):
            return []
        off = np.abs(fit.left_out) / np.where(std > 0.0, std, np.inf)
        if off.max(initial=0.0) <= 0.5:
            return []
        return [phrase(AS_PRINTED, self.way, np.abs(fit.left_out).max() / ARCSEC)]

    @cached_property
    def drift(self) -> Drift:
        """What the drift of the tracker did."""
        return Drift.of(self)

    def _protections(self) -> Iterator[Protection]:
        layout, problem = self.layout, self.layout.problem
        direct = layout.pairs is None
        open_ = spans_of(layout)[1]
        yield _drift(problem, open_)
        yield self._knock(open_)
        yield Protection(
            "repeatability",
            "not protected",
            phrase(
                "each position is reached once: the table's scatter between arrivals is "
                "in the curve, not in the uncertainty"
            ),
        )
        yield Protection(
            "refraction",
            "not protected",
            phrase(
                "a gradient of 1 K/m across the beam bends it by about 0.1 arcsec for each "
                "metre, and no residual need show it"
            ),
        )
        zero = phrase("no method knows the zero: deviations count from the first position")
        yield Protection("gauge", "harmless", zero)
        what = phrase("circles") if direct else phrase("lengths")
        scale = phrase("a scale of the range changes all {0} alike and no angle", what)
        yield Protection("scale", "harmless", scale)
        if not open_:  # else everything is said of the drift
            yield self._uneven_drift()
        if direct:
            yield Protection(
                "error motion",
                "not protected",
                phrase(
                    "a reflector on the table takes radial error motion for an angle, 0.7 "
                    "arcsec per micrometre at 300 mm; the residuals show only what is along "
                    "the radius"
                ),
            )
            lean = phrase(
                "a tilt of the table moves reflectors above its centre like radial error motion"
            )
            yield Protection("tilt", "not protected", lean)
            return
        motion = phrase("a mirror that is moved without turning keeps its normal")
        yield Protection("error motion", "harmless", motion)
        limit = problem.tilt_std / ARCSEC
        stated = phrase(
            "by the stated tilts of the table of {0:g} arcsec (tilt_std_arcsec)", limit
        )
        yield Protection("tilt", "bounded", stated)

    def _uneven_drift(self) -> Protection:
        stated = self.layout.problem.uneven_drift_std
        if stated > 0.0:
            return Protection(
                "uneven drift",
                "bounded",
                phrase(STATED_SWING, stated / ARCSEC),
            )
        error = float(ARCSEC / self.std[1:].min())
        return Protection(
            "uneven drift",
            "not protected",
            phrase(UNSEEN_DRIFT, error),
        )

    def _knock(self, open_: Sequence[int]) -> Protection:
        carried = phrase("a reflector") if self.layout.pairs is None else phrase("a mirror")
        closes = self.whole_turn.get("closure_std_rad")
        if closes is None:
            return Protection(
                "knock",
                "not protected",
                phrase(
                    "no position was measured again after a whole turn: {0} that moved on "
                    "the table turns all positions after it without a trace",
                    carried,
                ),
            )
        if open_:
            return Protection(
                "knock",
                "not protected",
                phrase(
                    "the closure shows {0} that moved, but only nests that are measured "
                    "again show a tracker knocked at its station",
                    carried,
                ),
            )
        found = normal_isf(self.layout.problem.significance / 2.0) + normal_isf(1.0 - POWER)
        on_table = found * closes / float(self.std[1:].min())
        return Protection(
            "knock",
            "tested",
            phrase(
                "the closure shows {0} that moved, nests measured again show the tracker", carried
            ),
            max(on_table, self.drift.unseen_knock),
        )


def _drift(problem: PlaneMirrorProblem, open_: Sequence[int]) -> Protection:
    if open_:
        names = ", ".join(problem.station_name(s) for s in open_)
        return Protection(
            "drift",
            "not protected",
            phrase(NOT_MEASURED_AGAIN, names),
        )
    return Protection(
        "drift",
        "estimated",
        phrase(
            "nests measured again show turns, shifts and range of the tracker at each "
            "station, linear in time between rounds of nests; a part that moves a deviation "
            "by more than one standard uncertainty makes the result suspect"
        ),
    )


@dataclass(frozen=True, eq=False)
class Drift:
    """What taking the drift off did to the deviations, span by span (K).

    ``change`` (K, 7) is what the frame moved by in each, with ``covariance`` (K, 7, 7). ``share``
    (2, K, N): what that did to the deviations, and what the swings did, in standard uncertainties.
    ``noise`` (2, K, N): what noise, and swings as they are stated, do to these.
    """

    solution: MirrorSolution
    change: Floats
    covariance: Floats
    share: Floats
    noise: Floats

    @classmethod
    def of(cls, solution: MirrorSolution) -> Drift:
        """Return what the drift did in a solution."""
        found, tracker, fit = solution.found, solution.tracker, solution.found.fit
        part, end = tracker.part["drift"], tracker.part["swing"].stop
        change = fit.x[part].reshape(-1, PARTS)
        n, k, d = len(found.value), len(change), change.size
        if not k:
            none = np.zeros((2, 0, n))
            return cls(solution, change, np.zeros((0, PARTS, PARTS)), none, none)
        # what each did while the others are as they were found, which would take up some of it
        gain = found.scale * fit.gain(slice(part.start, end))
        whole, rows = gain @ gain.T, np.arange(len(fit.std))
        outputs = found.scale * fit.kernel.response(fit.model.output_rows, rows)[:n]
        by = np.linalg.solve(whole, gain @ outputs.T).T
        own = np.einsum("kpkq->kpq", whole[:d, :d].reshape(k, PARTS, k, PARTS))
        size = (end - part.start - d) // k
        swung = np.einsum("kpkq->kpq", whole[d:, d:].reshape(k, size, k, size))
        stated = np.eye(size) * np.square([span.std for span in tracker.spans])[:, None, None]
        scale = np.where(solution.std > 0.0, solution.std, np.inf)  # the first position has none
        share, noise = np.zeros((2, 2, k, n))
        for which, columns, spread in ((0, slice(d), own), (1, slice(d, None), stated - swung)):
            influence = by[:, columns].reshape(n, k, -1)
            x = fit.x[part.start : end][columns].reshape(k, -1)
            share[which] = np.abs(np.einsum("nkp,kp->kn", influence, x)) / scale
            square = np.einsum("nkp,kpq,nkq->kn", influence, spread, influence)
            noise[which] = np.sqrt(np.maximum(square, 0.0)) / scale
        return cls(solution, change, own, share, noise)

    @property
    def limits(self) -> Floats:
        """From where on (2, K, N) a part is too large: LARGE, or what noise does at most."""
        problem = self.solution.layout.problem
        return np.maximum(LARGE, normal_isf(problem.significance / 2.0) * self.noise)

    @property
    def doubts(self) -> list[Phrase]:
        """In words at which stations it is larger than may be taken as linear."""
        found = list[Phrase]()
        station, limits = self.stations, self.limits
        for number in np.unique(station).tolist():
            own = station == number
            if not np.any(self.share[:, own] > limits[:, own]):
                continue
            total = self.change[own].sum(axis=0)
            x, y, azimuth = total[:3] / ARCSEC
            found.append(
                phrase(
                    MOVED_BETWEEN_ROUNDS,
                    self.solution.layout.problem.station_name(number),
                    azimuth,
                    x,
                    y,
                    total[6] / MICROMETRE,
                    self.share[:, own].max(),
                )
            )
        return found

    @property
    def stations(self) -> Ints:
        """The station (K,) of each span."""
        return np.array([span.station for span in self.solution.tracker.spans], dtype=np.int64)

    @property
    def unseen_knock(self) -> float:
        """The error of a knock of the tracker that is found with POWER, in uncertainties."""
        found = self.limits + normal_isf(1.0 - POWER) * self.noise
        return float(KNOCK * found[0, :, 1:].max(initial=0.0))

    def probability(self, station: int) -> float:
        """Return how probable changes this large are at a station where nothing drifts."""
        own = self.stations == station
        square = sum(
            float(c @ np.linalg.solve(v, c))
            for c, v in zip(self.change[own], self.covariance[own], strict=True)
        )
        return chi2_sf(square, PARTS * int(own.sum()))

    @property
    def details(self) -> dict[str, Any]:
        """The drift of each station for a result; nothing where none was estimated."""
        spans, found = self.solution.tracker.spans, list[dict[str, Any]]()
        spread = np.sqrt(np.einsum("kpp->kp", self.covariance))
        for number in np.unique(self.stations).tolist():
            own = np.flatnonzero(self.stations == number)
            found.append(
                {
                    "station": self.solution.layout.problem.station_name(number),
                    "knots": [spans[own[0]].begin, *(spans[k].end for k in own)],
                    "turn_rad": self.change[own, :3],
                    "turn_std_rad": spread[own, :3],
                    "shift_m": self.change[own, 3:6],
                    "shift_std_m": spread[own, 3:6],
                    "range_m": self.change[own, 6],
                    "range_std_m": spread[own, 6],
                    "probability": self.probability(number),
                    "moved_standard_uncertainties": self.share[0, own].max(axis=1),
                }
            )
        return {"drift": found} if found else {}


def check_size(problem: PlaneMirrorProblem, angles: Floats, deviations: Floats) -> None:
    """Refuse deviations that no table has, naming the worst position; ``angles`` (N,) rad."""
    worst = int(np.argmax(np.abs(deviations)))
    if not np.all(np.isfinite(deviations)) or abs(deviations[worst]) > MAX_DEVIATION:
        raise DataError(
            f"{problem.source}: the table position commanded to {angles[worst] / DEGREE:g} deg "
            f"comes out {deviations[worst] / DEGREE:.2f} deg off; no table is that wrong: "
            "reflector on the wrong nest, wrong position number, or wrong commanded angle; "
            "correct it"
        )


def differing(repeats: Sequence[Closure], angles: Floats, significance: float) -> list[Phrase]:
    """Return a sentence about positions that differ, commanded to the same of ``angles`` (N,)."""
    return [
        phrase(
            REPEATS_DIFFER,
            angles[c.first] / DEGREE,
            angles[c.last] / DEGREE,
            c.error / ARCSEC,
            2 * c.std / ARCSEC,
        )
        for c in repeats
        if c.open(significance)
    ]
