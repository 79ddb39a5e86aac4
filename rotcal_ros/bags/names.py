"""Names inside a bag: attachments, metadata records, topics and message types."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from rotcal_ros.foundation import session_folder

CONFIGURATION: Final = session_folder.CONFIGURATION
"""Attachment: the configuration text, byte for byte as it was given."""
PARAMETERS: Final = "parameters.json"
"""Attachment: every parameter of every node, by node name."""
VERSIONS: Final = "versions.json"
"""Attachment: versions of packages, Python, operating system and ROS middleware."""
DEFINITIONS: Final = "definitions.json"
"""Attachment: a second copy of all schemas and channels, in case their chunk is damaged."""

LOSSES: Final = "rotcal_losses"
"""Metadata record: loss counters by name, the last one counts."""
LOST: Final = "lost"
"""First word of the counters of messages that did not reach the recorder."""
QUEUE: Final = "queue"
"""First word of the counters of messages that found the recorder's queue full."""
SILENT: Final = "silent"
"""First word of the counters of silences of a stream."""
CLOCK_JUMPS: Final = "rotcal_clock_jumps"
"""Metadata record: jumps of the recorder's system clock since the bag was begun, by number."""
UNHEARD: Final = "incompatible publisher"
"""First words of the counters of publishers that no subscriber can receive."""
DROPOUTS: Final = "dropouts"
"""Last name of the recorder's topic that says what is missing, and from when to when."""
LEFT_ALONE: Final = "left_alone"
"""Last word of the recorder's topics for messages of ignored publishers on a topic of the run."""
RUN: Final = "rotcal_run"
"""Metadata record: ``number`` of the run of an interrupted plan that the file belongs to, and
``session``, which all files of all its runs have in common; ``earlier`` is RECORDED where the run
continued from the recorded observations, not from those that the earlier streams give."""
RECORDED: Final = "recorded"
CONTINUED: Final = "rotcal_continued"
"""Metadata record: ``in`` which file the session continues; after an interruption also where the
file had ended, how many bytes of a torn record stood there, and when it was closed."""
TORN: Final = "torn_record.bin"
"""Attachment: the bytes of a torn record that stood at the end of an interrupted file."""
SUBJECT: Final = "rotcal_subject"
"""Metadata record: ``item`` that was measured, and ``simulated``, true or false."""
TOPICS: Final = "rotcal_topics"
"""Metadata record: role -> topic of those with another name than their role below the cell's
namespace, by remapping or by the group ``topics``; the last one counts."""
REPAIR: Final = "rotcal_repair"
"""Metadata record of a repaired bag: what was lost of each original file, and when."""
ROSBAG2: Final = "rosbag2"
"""Metadata record: rosbag2's own description of the bag."""

PLAN: Final = "plan"
TRACER_LENGTH: Final = "tracer_length"
PROBE_POINT: Final = "probe_point"
JOINT_STATES: Final = "joint_states"
TEMPERATURE: Final = "temperature"
AIR_PRESSURE: Final = "air_pressure"
RELATIVE_HUMIDITY: Final = "relative_humidity"
TABLE_ANGLE: Final = "table_angle"
PROBE_TARGET: Final = "probe_target"
OBSERVATION: Final = "observation"
OBSERVATION_RECORDED: Final = "observation_recorded"
STEP_CHOICE: Final = "step_choice"
TABLE_IN_FORCE: Final = "table_in_force"
PAUSE: Final = "pause"
HEARTBEAT: Final = "heartbeat"
GOAL: Final = "goal"
PROGRESS: Final = "progress"
"""Goal and feedback of the action as plain messages: readers of bags refuse the types that ROS
makes of an action."""
GOAL_STATUS: Final = "calibrate/_action/status"
"""The only topic of the action that is recorded; it is hidden from people."""
TF_STATIC: Final = "/tf_static"
"""Static transforms of all cells of a domain; outside of every namespace, and not needed."""

ROLES: Final = frozenset({
    PLAN, TRACER_LENGTH, PROBE_POINT, JOINT_STATES, TEMPERATURE, AIR_PRESSURE,
    RELATIVE_HUMIDITY, TABLE_ANGLE, PROBE_TARGET, OBSERVATION, STEP_CHOICE, TABLE_IN_FORCE,
})  # fmt: skip
"""Topics that a replay needs, by their last name."""


_DIGITS: Final = 9
"""A number with more digits was not written by a recorder."""


def run_number(metadata: Mapping[str, Mapping[str, str]], unknown: int = 0) -> int:
    """Return the number of the run in the metadata of a file; ``unknown`` if there is none."""
    number = metadata.get(RUN, {}).get("number", "")
    is_one = number.isascii() and number.isdecimal() and len(number) <= _DIGITS
    return int(number) if is_one else unknown
