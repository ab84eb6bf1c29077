"""`gridpose demo`: a small rendered session, and with `--paper` the full experiment, through the real service."""
