"""Console scripts of the nodes, which load once they run."""

from vo2_interface.quiet_start import quiet_start

__all__ = ["rig"]

rig = quiet_start("rig_template.rig_node")
