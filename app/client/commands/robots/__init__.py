"""`gridpose robots`: those of a service."""
