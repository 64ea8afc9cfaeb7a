"""A browser page of the running graph, served on this host."""
