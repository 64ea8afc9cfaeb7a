"""What all tests of this package need."""

from vo2_plant_sim.testing import hear_ctrl_c

hear_ctrl_c()
