"""`gridpose sessions`: the commands on a data folder."""
