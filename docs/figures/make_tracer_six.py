"""Draw tracer_six.svg and tracer_six_places.svg: the sample data of the examples, solved.

The tracer stood at three places of a simulated table, two beams broke; the drawings are those of
the report.
"""

from pathlib import Path

import rotcal_ros as rc
from rotcal_ros.methods.figures.curves import deviations
from rotcal_ros.methods.tracer_six.figures import places_and_targets

HERE = Path(__file__).parent
DATA = HERE.parents[1] / "examples" / "data"


def main() -> None:
    """Solve and draw."""
    configuration = rc.read_configuration(DATA / "tracer_six.yaml")
    result = rc.read_table(DATA / "three_places" / "lengths.csv", configuration).solve()
    truth = {"angles_rad": result.angles, "deviations": rc.simulated_truth(configuration)}
    drawings = {
        "tracer_six": deviations(result, truth),
        "tracer_six_places": places_and_targets(result),
    }
    for name, drawing in drawings.items():
        (HERE / f"{name}.svg").write_text(drawing + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
