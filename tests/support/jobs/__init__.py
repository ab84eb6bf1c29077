"""Runners over queues, what their workers do, and rows and searches for them."""
