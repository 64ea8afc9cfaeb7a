"""What all tests of this package need."""

from vo2_interface.testing import hear_ctrl_c

hear_ctrl_c()
