"""`gridpose targets`: print a target, and check a printed one."""
