"""What the table's feedback says in the values of the capture's beat, and what is wrong in it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import isfinite

from rotcal_ros.bags import names
from rotcal_ros.capture.instruments.conventions import Conventions
from rotcal_ros.capture.instruments.plausibility import implausible_angle
from rotcal_ros.foundation.escapes import printable
from rotcal_ros.methods import Configuration
from rotcal_ros.nodes.runtime.latest import JOINT, MOST_JOINTS, NOW
from rotcal_ros.nodes.runtime.topic_names import name_in
from rotcal_ros.planning.table_motion import PUBLISH_VELOCITY

Values = Mapping[str, str]


def joint_faults(values: Values, joint: str) -> Iterator[str]:
    """Yield what is wrong with the joint that stands for the table."""
    heard = joints(values)
    chosen, topic = chosen_joint(values, joint), name_in(values, names.JOINT_STATES)
    if not heard or (chosen not in heard and len(heard) >= MOST_JOINTS):  # not all are told
        return
    if chosen not in heard:
        yield (
            f"{topic} has no joint {joint!r} (cell.joint), it has "
            f"{', '.join(map(printable, heard))}: name one of these, or leave cell.joint empty "
            "for the first"
        )
    elif not isfinite(heard[chosen][1]):
        yield (
            f"{topic}: joint {printable(chosen)} has no velocity, without which no "
            f"table is at rest: {PUBLISH_VELOCITY}"
        )


def joint_doubts(values: Values, configuration: Configuration) -> Iterator[str]:
    """Yield what looks wrong about the table's angle."""
    text = implausible_angle(table_angle(values, configuration), configuration.topics)
    if text:
        yield f"{name_in(values, names.JOINT_STATES)} {text}"


def table_angle(values: Values, configuration: Configuration) -> float:
    """Return where the table says it is (rad); 0 where it says nothing."""
    if chosen := joints(values).get(chosen_joint(values, configuration.cell.joint)):
        return Conventions(configuration.topics).angle(chosen[0])
    return number_in(values.get(NOW + names.JOINT_STATES, "")) or 0.0


def chosen_joint(values: Values, joint: str) -> str:
    """Return the joint that stands for the table: the configured one, else the first."""
    return joint or next(iter(joints(values)), "")


def joints(values: Values) -> dict[str, tuple[float, float]]:
    """Return angle (rad) and velocity (rad/s) of the joints that were heard, by name."""
    found = {}
    for key, value in values.items():
        if key.startswith(JOINT):
            angle, velocity = map(float, value.split())
            found[key.removeprefix(JOINT)] = (angle, velocity)
    return found


def number_in(text: str) -> float | None:
    """Return the number that a reading begins with, if it does and is finite."""
    try:
        number = float(text.split()[0])
    except (IndexError, ValueError):
        return None
    return number if isfinite(number) else None
