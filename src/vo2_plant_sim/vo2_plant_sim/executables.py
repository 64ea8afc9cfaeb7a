"""Console scripts of the nodes, which load once they run."""

from vo2_interface.quiet_start import quiet_start

__all__ = ["plant", "plants"]

plant = quiet_start("vo2_plant_sim.plant")
plants = quiet_start("vo2_plant_sim.plants")
