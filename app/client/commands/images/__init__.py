"""`gridpose upload` and `watch`: images to a session."""
