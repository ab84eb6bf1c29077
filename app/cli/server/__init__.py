"""Commands of an installation: serve, worker, keys, backup, restore and schema."""
