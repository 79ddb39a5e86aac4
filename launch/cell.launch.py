"""The nodes of one cell; with simulated:=true the simulated machine and instruments as well."""

from pathlib import Path
from tempfile import mkdtemp

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from rotcal_ros.catalogue import read_configuration
from rotcal_ros.catalogue.configuration import SIMULATION, node_parameters
from rotcal_ros.node_names import FURTHER_NODES, NODES, VIEWERS

CLOSING_S = "25"


def cell(context):
    """Return the nodes that the arguments and the configuration's groups ask for."""
    file = Path(LaunchConfiguration("configuration").perform(context))
    configuration = read_configuration(file)
    wanted = {
        argument
        for argument in ("simulated", *VIEWERS)
        if LaunchConfiguration(argument).perform(context) == "true"
    }
    if "simulated" in wanted and not configuration.simulated:
        raise RuntimeError(
            f"simulated:=true, but {file} is for a real cell: it has no group '{SIMULATION}'"
        )
    given = configuration.given if "simulated" in wanted else configuration.given - {SIMULATION}
    further = (node for group, node in FURTHER_NODES.items() if group in given)
    viewers = (node for argument, node in VIEWERS.items() if argument in wanted)
    # ROS takes one type in a list, and no group that is empty; people write what they like.
    parameters = Path(mkdtemp(prefix="rotcal_")) / "parameters.yaml"
    parameters.write_text(node_parameters(configuration), encoding="utf-8")
    return [node(name, parameters) for name in (*NODES, *further, *viewers)]


def node(name, parameters):
    """Return the action that starts a node with a file of parameters."""
    return Node(
        package="rotcal_ros",
        executable=name,
        name=name,
        namespace=LaunchConfiguration("namespace"),
        parameters=[str(parameters)],
        output="screen",
        respawn=False,
        # Closing a bag takes time: no SIGKILL before the recorder had it.
        sigterm_timeout=CLOSING_S,
        sigkill_timeout=CLOSING_S,
    )


def generate_launch_description():
    demo = PathJoinSubstitution([FindPackageShare("rotcal_ros"), "config", "tracer_demo.yaml"])

    def argument(name, default, description, **more):
        return DeclareLaunchArgument(name, default_value=default, description=description, **more)

    def switch(name, description):
        return argument(name, "false", description, choices=["true", "false"])

    return LaunchDescription(
        [
            argument("configuration", demo, "Configuration of the calibration."),
            argument("namespace", "/cell", "Namespace of the cell's topics."),
            switch("simulated", "Simulate the machine and the instruments."),
            switch("page", "Serve the operator's page; its address is logged."),
            switch("scene", "Publish markers for RViz and Foxglove."),
            OpaqueFunction(function=cell),
        ]
    )
