"""The names of the policies, as configurations give them."""

from typing import Final

AS_LISTED: Final = "as_listed"
UNTIL_GOAL: Final = "until_goal"
