"""The capture node: subscribes to the instruments and publishes observations."""
