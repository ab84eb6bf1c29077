"""`gridpose targets`: those of a service."""
