"""Do two methods find the same table? E_n for every angle, and what a wrong sign looks like."""

from dataclasses import replace
from pathlib import Path

import rotcal_ros as rc

DATA = Path(__file__).parent / "data"

tracer = rc.read_result(DATA / "result_tracer.json")
plate = rc.read_result(DATA / "result_ball_plate.json")
compared = rc.compare(tracer, plate)
print(compared.describe())

wrong = replace(plate, deviations={"ECC": -plate.deviations["ECC"]})
compared = rc.compare(tracer, wrong)
print(compared.describe())
print(*compared.notes, sep="\n")
