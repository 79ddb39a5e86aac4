"""The nodes of one cell; with simulated:=true the simulated machine and instruments as well."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from rotcal_ros.catalogue import read_configuration
from rotcal_ros.node_names import FURTHER_NODES, NODES, VIEWERS

CLOSING_S = "25"


def generate_launch_description():
    configuration = LaunchConfiguration("configuration")
    demo = PathJoinSubstitution([FindPackageShare("rotcal_ros"), "config", "tracer_demo.yaml"])

    def node(name, **more):
        return Node(
            package="rotcal_ros",
            executable=name,
            name=name,
            namespace=LaunchConfiguration("namespace"),
            parameters=[configuration],
            output="screen",
            respawn=False,
            # Closing a bag takes time: no SIGKILL before the recorder had it.
            sigterm_timeout=CLOSING_S,
            sigkill_timeout=CLOSING_S,
            **more,
        )

    def wanted(context, group, name):
        """Start a node with a group of its own; the simulated cell only when asked to."""
        file = configuration.perform(context)
        asked = group in read_configuration(Path(file)).given
        if group == "simulation" and LaunchConfiguration("simulated").perform(context) == "true":
            if not asked:
                raise RuntimeError(
                    f"simulated:=true, but {file} is for a real cell: it has no group 'simulation'"
                )
        elif group == "simulation":
            asked = False
        return [node(name)] if asked else []

    def shown(context, argument, name):
        """Start a node for people when asked to."""
        return [node(name)] if LaunchConfiguration(argument).perform(context) == "true" else []

    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "configuration",
                default_value=demo,
                description="Configuration of the calibration: an ordinary parameter file.",
            ),
            DeclareLaunchArgument(
                "namespace", default_value="/cell", description="Namespace of the cell's topics."
            ),
            DeclareLaunchArgument(
                "simulated",
                default_value="false",
                description="Simulate the machine and the instruments.",
                choices=["true", "false"],
            ),
            DeclareLaunchArgument(
                "page",
                default_value="false",
                description="Serve the operator's page; its address is logged.",
                choices=["true", "false"],
            ),
            DeclareLaunchArgument(
                "scene",
                default_value="false",
                description="Publish markers for RViz and Foxglove.",
                choices=["true", "false"],
            ),
            *(node(name) for name in NODES),
            *(
                OpaqueFunction(function=lambda context, g=group, n=name: wanted(context, g, n))
                for group, name in FURTHER_NODES.items()
            ),
            *(
                OpaqueFunction(function=lambda context, a=argument, n=name: shown(context, a, n))
                for argument, name in VIEWERS.items()
            ),
        ]
    )
