"""Console scripts of the nodes, which load once they run."""

from vo2_interface.quiet_start import quiet_start

__all__ = ["beam", "live", "supervise"]

live = quiet_start("vo2_interface.live.node")
beam = quiet_start("vo2_interface.beam")
supervise = quiet_start("vo2_interface.supervise")
