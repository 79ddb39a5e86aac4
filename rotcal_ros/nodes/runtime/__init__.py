"""What all nodes share: states, parameters, heartbeats, subscriptions and messages."""
