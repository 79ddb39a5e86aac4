"""Packaging, for pip and for colcon, which needs the index of ament."""

from setuptools import find_packages, setup

NAME = "rotcal_ipp_dme"
VERSION = "1.0.0"
NODE = f"dme_adapter = {NAME}.node:main"

setup(
    name=NAME,
    version=VERSION,
    description="Measuring machines behind I++ DME for rotcal_ros, and a simulated one",
    maintainer="rotcal maintainers",
    maintainer_email="maintainers@rotcal.invalid",
    license="Apache-2.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={"": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", ["config/ball_plate_dme.yaml"]),
    ],
    python_requires=">=3.10",
    install_requires=["click>=8.1", "numpy>=1.26", f"rotcal_ros=={VERSION}"],
    entry_points={
        "console_scripts": [NODE],
        "rotcal_ros.nodes": [NODE],
        "rotcal_ros.group_nodes": [f"dme = {NAME}:NODE"],
        "rotcal_ros.driver_checks": [f"dme = {NAME}.check:CHECK"],
        "rotcal_ros.settings": [f"dme = {NAME}.settings:DmeSettings"],
        "rotcal_ros.verbs": [f"dme = {NAME}:VERB"],
    },
    zip_safe=False,
)
