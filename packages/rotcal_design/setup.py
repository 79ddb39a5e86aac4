"""Packaging, for pip and for colcon, which needs the index of ament."""

from setuptools import find_packages, setup

NAME = "rotcal_design"
VERSION = "1.0.0"
PLANS = {
    "advise": "advise",
    "check": "check",
    "effort": "plates",
    "plate": "plates",
    "sequence": "sequence",
    "tracer": "tracer",
    "trade": "trade",
}
"""Command below ``rotcal plan`` -> its module."""

setup(
    name=NAME,
    version=VERSION,
    description="Optimal plans for rotcal_ros: which lengths and balls reach an uncertainty",
    maintainer="rotcal maintainers",
    maintainer_email="maintainers@rotcal.invalid",
    license="Apache-2.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={"": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    python_requires=">=3.10",
    install_requires=["click>=8.1", "numpy>=1.26", f"rotcal_ros=={VERSION}"],
    entry_points={
        "rotcal_ros.plans": [
            f"{plan} = {NAME}.verbs.{module}:{plan}" for plan, module in PLANS.items()
        ],
        "rotcal_ros.goals": [f"tracer = {NAME}.settings:TracerDesignSettings"],
        "rotcal_ros.functions": [f"plan_plate = {NAME}.ball_plate.ball_layout:plan_plate"],
    },
    zip_safe=False,
)
