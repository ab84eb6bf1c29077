"""Benchmarks of single images: decoding, detection, corners, every kind of target, the fit, and all of it at once."""
