"""What an analysis is computed from: a session's rows, their hash, and their values for `core.session`."""
