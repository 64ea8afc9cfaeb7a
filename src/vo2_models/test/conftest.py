"""Before numpy is loaded: one thread for linear algebra. Small problems on a busy machine wait for each other otherwise."""

import os

for pool in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(pool, "1")
