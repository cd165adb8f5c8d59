"""One thread for matrix products: the tests' are small, and on a busy machine threads wait."""

import os

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
