"""Packaging, for pip and for colcon, which needs the index of ament."""

from setuptools import find_packages, setup

NAME = "rotcal_controllers"
VERSION = "1.0.0"
CONTROLLERS = {
    "acs": "Acs",
    "aerotech": "Aerotech",
    "centroid": "Centroid",
    "encoder_lut": "EncoderLut",
    "fagor": "Fagor",
    "fanuc": "Fanuc",
    "heidenhain": "Heidenhain",
    "kflop": "Kflop",
    "mach4": "Mach4",
    "pmac": "Pmac",
    "sinumerik": "Sinumerik",
    "smoothieware": "Smoothieware",
    "twincat": "TwinCat",
    "twincat_nc": "TwinCatNc",
}
"""Name, which is its module's too -> class."""

setup(
    name=NAME,
    version=VERSION,
    description="Controllers for rotcal_ros beside CSV and LinuxCNC; OPC UA and ADS",
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
    install_requires=["numpy>=1.26", f"rotcal_ros=={VERSION}"],
    extras_require={"ads": ["pyads"], "opcua": ["asyncua", "cryptography"]},
    entry_points={
        "rotcal_ros.controllers": [
            f"{controller} = {NAME}.{controller}:{kind}"
            for controller, kind in CONTROLLERS.items()
        ],
        "rotcal_ros.stores": [
            f"ads = {NAME}.network_stores.ads_link:ads_store [ads]",
            f"opcua = {NAME}.network_stores.opcua_link:opcua_store [opcua]",
        ],
        "rotcal_ros.store_settings": [
            f"ads = {NAME}.network_stores.settings:AdsSettings",
            f"opcua = {NAME}.network_stores.settings:OpcUaSettings",
        ],
    },
    zip_safe=False,
)
