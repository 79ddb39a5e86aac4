"""The middleware of ROS 2: its distribution, and discovery and transport of our nodes.

They talk over UDP: a node that is killed then blocks no other.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import distributions
from importlib.resources import files
from typing import Final

from rotcal_ros.foundation.errors import ConfigurationError

RANGE: Final = "ROS_AUTOMATIC_DISCOVERY_RANGE"
LOCALHOST: Final = "LOCALHOST"
ROS_DEFAULT_RANGE: Final = "SUBNET"
_PROFILES: Final = {
    "FASTDDS_DEFAULT_PROFILES_FILE": "fastdds",
    "FASTRTPS_DEFAULT_PROFILES_FILE": "fastrtps",
}
"""Variable -> beginnings of the names of our files for it: for Fast DDS 3, and for 2 (Jazzy)."""
_OF_DISTRIBUTION: Final = {
    "jazzy": "FASTRTPS_DEFAULT_PROFILES_FILE",
    "kilted": "FASTDDS_DEFAULT_PROFILES_FILE",
    "lyrical": "FASTDDS_DEFAULT_PROFILES_FILE",
}
_LOOPBACK: Final = "loopback.xml"
_NETWORK: Final = "network.xml"
_TRANSPORTS: Final = "FASTDDS_BUILTIN_TRANSPORTS"
_OWN: Final = (*_PROFILES, "ROS_STATIC_PEERS")
_FAST_DDS: Final = ("", "rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp")


def middleware(environment: Mapping[str, str], default_range: str = LOCALHOST) -> dict[str, str]:
    """Return the environment variables that decide about discovery and transport.

    ``environment`` holds what the user has set, ``default_range`` the range of discovery
    otherwise. Profiles and peers of the user, and middlewares other than Fast DDS, stay as they
    are.

    ROS's own LOCALHOST makes Fast DDS use shared memory, whatever its profile says; therefore
    our profile confines it to the loopback interface instead.
    """
    wanted = environment.get(RANGE) or default_range
    fast_dds = environment.get("RMW_IMPLEMENTATION", "") in _FAST_DDS
    if not fast_dds or any(map(environment.get, _OWN)):
        return {RANGE: wanted}
    if wanted == LOCALHOST:
        return {RANGE: "SYSTEM_DEFAULT", **_profiles(_LOOPBACK)}
    transports = environment.get(_TRANSPORTS) or "UDPv4"
    return {RANGE: wanted, _TRANSPORTS: transports, **_profiles(_NETWORK)}


def _profiles(kind: str) -> dict[str, str]:
    """Return the profile for the Fast DDS here: each version prints errors about the other's."""
    folder = files("rotcal_ros") / "nodes"
    variable = _OF_DISTRIBUTION.get(distribution(rclpy_version()) or "")
    wanted = _PROFILES if variable is None else {variable: _PROFILES[variable]}
    return {name: str(folder / f"{begin}_{kind}") for name, begin in wanted.items()}


def explain_start_failure(environment: Mapping[str, str], message: str) -> None:
    """Raise ConfigurationError if ROS may have failed to start because its security is on.

    ``message`` is what ROS said.
    """
    if environment.get("ROS_SECURITY_ENABLE", "").lower() == "true":
        raise ConfigurationError(
            f"ROS does not start with ROS_SECURITY_ENABLE=true ({message.splitlines()[0]}): the "
            "Fast DDS of the wheels has no security plug-ins, and a keystore is required; use a "
            "full ROS 2 installation, or unset ROS_SECURITY_ENABLE and isolate the network "
            "instead (docs/security.md)"
        )


def discovery_in_words(environment: Mapping[str, str]) -> str:
    """Return where this process looks for others, and what those on other machines need."""
    confined = any(environment.get(name, "").endswith(_LOOPBACK) for name in _PROFILES)
    reach = LOCALHOST if confined else environment.get(RANGE) or ROS_DEFAULT_RANGE
    domain = environment.get("ROS_DOMAIN_ID") or "0"
    return (
        f"looked for with ROS_DOMAIN_ID={domain} and {RANGE}={reach}: others need the same domain"
        + (f", and those on other machines {RANGE}=SUBNET here" if reach == LOCALHOST else "")
    )


SUPPORTED: Final = ("jazzy", "kilted")
_OF_RCLPY: Final = {3: "humble", 4: "iron", 7: "jazzy", 9: "kilted", 10: "lyrical"}
_PACKAGES: Final = ("rclpy", "ros-rclpy")
"""The name in an installation of ROS, and that of the wheels."""


def rclpy_version() -> str | None:
    """Return the version of rclpy, if one is installed."""
    installed = (found for package in _PACKAGES for found in distributions(name=package))
    return next((package.version for package in installed), None)


def distribution(rclpy: str | None) -> str | None:
    """Return the distribution with this version of rclpy, as in ROS_DISTRO, if it is known."""
    major = (rclpy or "").partition(".")[0]
    return _OF_RCLPY.get(int(major)) if major.isdecimal() else None
