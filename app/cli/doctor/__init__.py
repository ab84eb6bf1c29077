"""`gridpose doctor`: one module per subject that is checked; no check changes anything."""
