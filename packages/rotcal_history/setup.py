"""Packaging, for pip and for colcon, which needs the index of ament."""

from setuptools import find_packages, setup

NAME = "rotcal_history"
VERSION = "1.0.0"
NODE = f"calibration_status = {NAME}.node.calibration_status:main"

setup(
    name=NAME,
    version=VERSION,
    description="The results of all tables for rotcal_ros: what has changed, what is due",
    maintainer="rotcal maintainers",
    maintainer_email="maintainers@rotcal.invalid",
    license="Apache-2.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={"": ["py.typed", "templates/*", "translations/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    python_requires=">=3.10",
    install_requires=[
        "alembic>=1.13",
        "click>=8.1",
        "jinja2>=3.1",
        "numpy>=1.26",
        "psycopg[binary]>=3.1",
        "pyarrow>=15.0",
        f"rotcal_ros=={VERSION}",
        "scipy>=1.11",
        "sqlalchemy>=2.0",
    ],
    extras_require={
        "dcc": ["cryptography", "lxml", "signxml"],
        "many": ["distributed", "fsspec"],
    },
    entry_points={
        "console_scripts": [NODE],
        "rotcal_ros.nodes": [NODE],
        "rotcal_ros.verbs": [f"history = {NAME}:VERB", f"reprocess = {NAME}.fleet:VERB"],
        "rotcal_ros.settings": [f"history = {NAME}.settings:HistorySettings"],
        "rotcal_ros.histories": [f"history = {NAME}.adding"],
        "rotcal_ros.certificates": [f"dcc = {NAME}.certificate.verbs:write_certificate [dcc]"],
        "rotcal_ros.functions": [
            f"write_certificate = {NAME}.certificate.writing:write_certificate [dcc]"
        ],
        "rotcal_ros.translations": [f"{NAME} = {NAME}"],
    },
    zip_safe=False,
)
