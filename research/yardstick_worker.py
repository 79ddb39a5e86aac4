"""Measure what research/yardstick.py asks of one code: jobs come in as JSON lines, answers go out.

It runs beside any version of the package and uses only what all of them have: plans, their
simulated measurements, the solver, the bench of effects and the commands.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml

from rotcal_ros.evaluation import power as evaluation_power
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import RotcalError
from rotcal_ros.foundation.results import Result
from rotcal_ros.methods import parse_configuration, prepare, read_configuration

Answer = dict[str, Any]
PowerBench: Final = getattr(evaluation_power, "PowerBench", None) or evaluation_power.Bench
"""Its name until 1.0."""
DRAWN: Final = {"tracer_multistation": ("error motion",), "plane_mirror": ("tilt",)}
"""What a simulated measurement draws as it is stated, without being asked."""
NOISE: Final = 2e-7
"""Of readings that are solved against the clock, m or rad."""
LARGEST_BYTES: Final = 6 << 30
LONGEST_S: Final = 120
COMMAND: Final = (sys.executable, "-S", "-c", "from rotcal_ros.cli.start import main; main()")


@lru_cache(maxsize=2)
def bench(plan: str, runs: int) -> Any:
    """Return the bench of a plan's file."""
    return PowerBench(prepare(read_configuration(Path(plan))), runs)


def sound(job: Answer) -> Answer:
    """Solve a measurement with errors as they are stated; the errors per standard uncertainty."""
    here, number = bench(job["file"], 1), job["number"]
    calibration = here.calibration
    random = np.random.default_rng([number, 4])
    sizes = {
        d.effect: d.stated(calibration.configuration) * (d.scatters or random.standard_normal())
        for d in here.listed()
        if d.stated and d.effect not in DRAWN.get(calibration.method.name, ())
    }
    measured = calibration.measured(sizes, number)
    start = time.process_time()
    try:
        result = calibration.solve(measured.observations)
    except RotcalError as error:
        return {"verdict": type(error).__name__, "z": {}}
    seconds = time.process_time() - start
    angles = np.array(calibration.plan.distinct_angles)
    if not np.array_equal(result.angles, angles):
        return {"verdict": result.verdict, "z": {}}
    truth = calibration.method.gauge(angles, measured.truth)
    z = {name: rounded(value) for name, value in scores(result, truth).items()}
    return {"verdict": result.verdict, "seconds": round(seconds, 4), "z": z}


def scores(result: Result, truth: Mapping[str, Floats]) -> dict[str, Floats]:
    """Return errors per standard uncertainty of every curve, and of its steps."""
    errors: dict[str, tuple[Floats, Floats]] = {}
    for name in result.components:
        errors[name] = result.deviations[name] - truth[name], result.std[name]
    if result.adjacent_deviations is not None and result.adjacent_std is not None:
        steps = result.adjacent_deviations - np.diff(truth["ECC"])
        errors["steps"] = steps, result.adjacent_std
    return {name: error[std > 0.0] / std[std > 0.0] for name, (error, std) in errors.items()}


def rounded(values: Floats) -> list[float]:
    """Return numbers for a line of a file."""
    return [float(f"{value:.4g}") for value in values]


def sizes(job: Answer) -> Iterator[Answer]:
    """Search the size of each effect of a plan that is not ``known`` yet, SI."""
    here = bench(job["file"], job["runs"])
    for effect in here.listed():
        if effect.effect in job["known"]:
            continue
        row = here.row(effect)
        tried = row.beyond[0] if row.allowed else row.size
        yield {
            "case": row.effect,
            "tried": tried * effect.unit_si,
            "reached": row.reached,
            "allowed": row.size * effect.unit_si if row.allowed else None,
            "unit": row.unit,
            "unit_si": effect.unit_si,
        }


def power(job: Answer) -> Answer:
    """Try an effect of a size; its part in the deviations, per standard uncertainty."""
    here = bench(job["file"], 1)
    trial = here.trial(job["effect"], job["size"], job["number"])
    return {
        "noticed": bool(trial.noticed),
        "error": None if trial.error is None else rounded(trial.error),
        "named": job["effect"] in here.plain(0).unprotected,
    }


def clock(job: Answer) -> Answer:
    """Solve a plan of so many angles in this process, which does nothing else: time and memory."""
    resource.setrlimit(resource.RLIMIT_AS, (LARGEST_BYTES, LARGEST_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (LONGEST_S, LONGEST_S))
    try:
        calibration = prepare(
            parse_configuration(widened(Path(job["file"]).read_text(), job["angles"]))
        )
        calibration = calibration.of_distances
        random = np.random.default_rng(1)
        read = [
            replace(o, mean=tuple((o.mean + NOISE * random.standard_normal(len(o.mean))).tolist()))
            for o in calibration.nominal_observations()
        ]
        start = time.process_time()
        calibration.solve(read)
    except MemoryError:
        return {"failed": "memory"}
    except RotcalError as error:
        return {"failed": str(error).split(":")[0]}
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return {"seconds": time.process_time() - start, "peak_mb": round(peak, 1)}


def widened(text: str, angles: int | None) -> str:
    """Return a configuration with so many table angles; None: as it is."""
    if angles is None:
        return text
    document = yaml.safe_load(text)
    settings = document["/**"]["ros__parameters"]
    plan, step = settings["plan"], 360.0 / angles
    if "plate" in plan:
        steps = [k * angles // 12 + k % 7 for k in plan["plate"]["ball_steps"]]
        plan["plate"] |= {"grid": angles, "ball_steps": steps}
    else:
        plan |= {"table_positions": angles, "table_step_deg": step, "table_start_deg": 0.0}
    if "box_points" in plan:
        plan["box_points"] = [3, 2, 2]
    if "shifts_deg" in plan:  # the last angle is the first again
        step = 360.0 / (angles - 1)
        plan |= {"table_step_deg": step, "shifts_deg": [0.0, step, 3.0 * step, 6.0 * step]}
    return str(yaml.safe_dump(document))


def command(job: Answer) -> Answer:
    """Carry out ``rotcal`` once: processor time, and what of its result is compared."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    ran = subprocess.run([*COMMAND, *job["words"]], capture_output=True, text=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    answer: Answer = {"seconds": seconds, "code": ran.returncode}
    if job["words"][-1] == "--json" and ran.returncode == 0:
        found = json.loads(ran.stdout)
        answer |= {key: found[key] for key in ("verdict", "deviations", "std")}
    return answer


def claims(job: Answer) -> Answer:
    """Compute a paper again: finding and number of every claim."""
    with tempfile.TemporaryDirectory() as folder:
        words = ["reproduce", job["paper"], "-o", folder]
        subprocess.run([*COMMAND, *words], check=True, capture_output=True)
        found = json.loads((Path(folder) / f"{job['paper']}.json").read_text())["claims"]
    keys = ("where", "statement", "finding", "recomputed")
    return {"claims": [[claim[key] for key in keys] for claim in found]}


PARTS: Final = {
    "sound": sound, "power": power, "time": clock, "start": command, "claims": claims,
}  # fmt: skip


def main() -> None:
    """Answer each job, with what identifies it."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    for line in sys.stdin:
        job = json.loads(line)
        answers = sizes(job) if job["part"] == "sizes" else [PARTS[job["part"]](job)]
        for answer in answers:
            print(json.dumps({**job["key"], **answer}), flush=True)


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit(130)
