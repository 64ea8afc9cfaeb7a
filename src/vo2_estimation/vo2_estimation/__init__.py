"""Self-sensing on the graph: deflection from resistance."""
