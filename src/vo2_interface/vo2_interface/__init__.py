"""What a rig speaks on the graph: samples, quality of service, parameters, diagnostics, node start-up."""
