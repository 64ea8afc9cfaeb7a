"""Console scripts of the nodes, which load once they run."""

from vo2_interface.quiet_start import quiet_start

__all__ = ["controller", "feedforward", "loop", "reference"]

reference = quiet_start("vo2_control.reference_node")
controller = quiet_start("vo2_control.controller_node")
feedforward = quiet_start("vo2_control.feedforward_node")
loop = quiet_start("vo2_control.loop_node")
