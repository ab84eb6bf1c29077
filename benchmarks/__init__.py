"""Measurements against the goals: `make bench`, or `python -m benchmarks --only fit --seed 1 --quick`."""
