"""Console scripts of the nodes, which load once they run."""

from vo2_interface.quiet_start import quiet_start

__all__ = ["estimator"]

estimator = quiet_start("vo2_estimation.estimator_node")
