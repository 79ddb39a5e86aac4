"""The nodes of one cell, to be started by itself or included in the launch file of a machine.

ros2 launch rotcal_ros cell.launch.py --show-args
"""

import atexit
import sys
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode
from launch_ros.substitutions import FindPackageShare

from rotcal_ros.foundation.node_names import NODES, VIEWERS
from rotcal_ros.methods import read_configuration
from rotcal_ros.methods.configuration import SIMULATION, node_parameters
from rotcal_ros.nodes.adapters.machine_nodes import (
    AS_CONFIGURED,
    OWN,
    machine_nodes,
    nodes_for_role,
)

CLOSING_S = "25"
RESPAWN_S = 2.0
YES_NO = ["true", "false"]


def cell(context):
    """Return the nodes that the arguments and the configuration's groups ask for."""

    def value(argument):
        return LaunchConfiguration(argument).perform(context)

    file = Path(value("configuration"))
    configuration = read_configuration(file)
    simulated = value("simulated") == "true"
    if simulated and not configuration.simulated:
        raise RuntimeError(
            f"simulated:=true, but {file} is for a real cell: it has no group '{SIMULATION}'"
        )
    groups = {name for name in configuration.given if "." not in name}
    groups -= set() if simulated else {SIMULATION}
    machine = machine_nodes(groups, value("table"), value("probe"))
    viewers = [node for argument, node in VIEWERS.items() if value(argument) == "true"]
    # ROS takes one type in a list, and no group that is empty; people write what they like.
    parameters = Path(mkdtemp(prefix="rotcal_")) / "parameters.yaml"
    atexit.register(rmtree, parameters.parent, ignore_errors=True)  # respawned nodes read it
    parameters.write_text(node_parameters(configuration), encoding="utf-8")
    files = [str(parameters), *filter(None, [value("parameters")])]
    own = {
        "linuxcnc_driver": {
            "ini_file": value("linuxcnc_ini"),
            "linuxcnc_joint": int(value("linuxcnc_joint")),
        }
    }
    autostart = value("autostart") == "true"
    names = (*NODES, *machine, *viewers)
    place = value("namespace") or configuration.cell.namespace
    started = {"namespace": place, "respawn": value("respawn") == "true"}
    nodes = [
        node(name, [*files, {"autostart": autostart, **own.get(name, {})}], **started)
        for name in names
    ]
    words = [sys.executable, "-m", "rotcal_ros.nodes.readiness", place, *names]
    return [*nodes, ExecuteProcess(cmd=words, name="readiness", output="screen")]


def node(name, parameters, **started):
    """Return the action that starts a managed node, which configures and activates itself."""
    return LifecycleNode(
        package="rotcal_ros",
        executable=name,
        name=name,
        parameters=parameters,
        output="screen",
        respawn_delay=RESPAWN_S,
        **started,
        # Closing a bag takes time: no SIGKILL before the recorder had it.
        sigterm_timeout=CLOSING_S,
        sigkill_timeout=CLOSING_S,
    )


def argument(name, default, description, **more):
    """Return an argument; with ``choices`` those are shown too."""
    return DeclareLaunchArgument(name, default_value=default, description=description, **more)


def cell_arguments():
    """Return the arguments that say which cell it is, and how its nodes are started."""
    demo = PathJoinSubstitution([FindPackageShare("rotcal_ros"), "config", "tracer_demo.yaml"])
    return [
        argument(
            "configuration",
            demo,
            "Configuration of the calibration: one YAML file; every group in it becomes "
            "parameters of the nodes.",
        ),
        argument(
            "namespace",
            "",
            "Namespace of the cell's topics, services and nodes; empty: the configuration's "
            "cell.namespace.",
        ),
        argument(
            "respawn",
            "false",
            "Restart a node that has ended; a calibration waits for it (restart_wait_s).",
            choices=YES_NO,
        ),
        argument(
            "simulated",
            "false",
            "Simulate machine and instruments, as described in the group 'simulation'.",
            choices=YES_NO,
        ),
        argument(
            "parameters",
            "",
            "A further parameter file, which overrides the configuration; such as one that 'ros2 "
            "param dump' has written.",
        ),
        argument(
            "autostart",
            "true",
            "Nodes configure and activate themselves; false: they wait for 'ros2 lifecycle "
            "set' or for a manager of yours.",
            choices=YES_NO,
        ),
        argument(
            "page", "false", "Serve the operator's page; its address is logged.", choices=YES_NO
        ),
        argument("scene", "false", "Publish markers for RViz and Foxglove.", choices=YES_NO),
    ]


def machine_arguments():
    """Return the arguments that say which nodes play the machine."""
    return [
        argument(
            "table",
            AS_CONFIGURED,
            "Which node turns the table. as_configured: one whose group the configuration has, "
            "such as table_adapter, else none; own: a node of yours; table_adapter: a joint of "
            "ros2_control; linuxcnc_driver: a rotary axis of LinuxCNC; others belong to packages.",
            choices=[AS_CONFIGURED, OWN, *nodes_for_role("table")],
        ),
        argument(
            "probe",
            AS_CONFIGURED,
            "Which node moves the probe or reflector. as_configured: one whose group the "
            "configuration has, else none; own: a node of yours; others belong to packages.",
            choices=[AS_CONFIGURED, OWN, *nodes_for_role("probe")],
        ),
        argument("linuxcnc_ini", "", "linuxcnc_driver: ini file of LinuxCNC."),
        argument(
            "linuxcnc_joint",
            "0",
            "linuxcnc_driver: number of the table's joint, if the ini file does not state it.",
        ),
    ]


def generate_launch_description():
    """Return the arguments and the nodes."""
    nodes = OpaqueFunction(function=cell)
    return LaunchDescription([*cell_arguments(), *machine_arguments(), nodes])
