"""A benchmark that anyone can run against any detector: `python -m benchmarks.public`; README.md says how."""
