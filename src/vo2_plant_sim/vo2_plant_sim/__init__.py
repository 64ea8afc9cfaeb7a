"""The simulated device under test, and what a rig speaks on the graph."""
