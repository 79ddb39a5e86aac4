"""Packaging, for pip and for colcon, which needs the index of ament."""

from setuptools import find_packages, setup

NAME = "rotcal_tables"
VERSION = "1.0.0"

setup(
    name=NAME,
    version=VERSION,
    description="Any table of numbers for rotcal_ros: workbooks, texts, and a page in the browser",
    maintainer="rotcal maintainers",
    maintainer_email="maintainers@rotcal.invalid",
    license="Apache-2.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={"": ["py.typed", "words.yaml", "static/*", "translations/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    python_requires=">=3.10",
    install_requires=[
        "click>=8.1",
        "numpy>=1.26",
        "python-calamine>=0.2",
        "PyYAML>=6.0",
        f"rotcal_ros=={VERSION}",
        "starlette>=0.37",
        "uvicorn>=0.27",
    ],
    entry_points={
        "rotcal_ros.methods": [f"deviations = {NAME}.deviations.method:METHOD"],
        "rotcal_ros.method_settings": [f"deviations = {NAME}.deviations.settings:SETTINGS"],
        f"{NAME}.readers": [f"dmis = {NAME}.dmis:read", f"renishaw = {NAME}.renishaw:read"],
        "rotcal_ros.tables": [f"any = {NAME}.sheets.reading:READER"],
        "rotcal_ros.verbs": [f"web = {NAME}:VERB", f"pairs = {NAME}:PAIRS"],
        "rotcal_ros.translations": [f"{NAME} = {NAME}"],
    },
    zip_safe=False,
)
