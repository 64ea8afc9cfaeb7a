"""Console scripts of the nodes, which load once they run."""

from vo2_interface.quiet_start import quiet_start

__all__ = ["plant"]

plant = quiet_start("vo2_plant_sim.plant")
