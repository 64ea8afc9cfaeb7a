"""A rig of one's own: the node that stands between the graph and a DAQ, and an instrument to try it with."""
