"""Packaging, for pip and for colcon, which needs the index of ament."""

from setuptools import find_packages, setup

NAME = "rotcal_papers"
VERSION = "1.0.0"

setup(
    name=NAME,
    version=VERSION,
    description="The papers behind rotcal_ros, computed again: tables, figures, claims",
    maintainer="rotcal maintainers",
    maintainer_email="maintainers@rotcal.invalid",
    license="Apache-2.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={"": ["py.typed", "templates/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    python_requires=">=3.10",
    install_requires=[
        "click>=8.1",
        "numpy>=1.26",
        "PyYAML>=6.0",
        f"rotcal_ros=={VERSION}",
    ],
    entry_points={"rotcal_ros.verbs": [f"reproduce = {NAME}:VERB"]},
    zip_safe=False,
)
