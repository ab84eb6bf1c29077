"""Measurements against the goals: `make bench`, or `python -m benchmarks --only fit --seed 1 --quick`."""

import os

# As worker processes have it: one thread each, so that processor time is that of the work alone.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
