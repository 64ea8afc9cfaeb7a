"""Before numpy is loaded: one thread for linear algebra, as the commands have it; and Ctrl-C, as every test of nodes needs it."""

import os

for pool in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(pool, "1")

from vo2_interface.testing import hear_ctrl_c  # noqa: E402

hear_ctrl_c()
