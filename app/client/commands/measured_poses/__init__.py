"""`gridpose measured-poses import`: poses measured by another instrument."""
