"""Options of the verbs that hold curves against each other."""

from __future__ import annotations

from typing import Final

import click

from rotcal_ros.components import COMPONENTS

component_option: Final = click.option(
    "--component",
    type=click.Choice(COMPONENTS),
    default="ECC",
    show_default=True,
    help="The deviation that counts.",
)
align_option: Final = click.option(
    "--align-order",
    type=click.IntRange(0, 12),
    default=0,
    show_default=True,
    help="Harmonics taken off beside the offset; 1 for radial deviations of other origins.",
)
