"""`gridpose sessions`: what a service holds, its targets, and computing it again."""
