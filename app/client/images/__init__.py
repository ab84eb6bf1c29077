"""Image files and how they get to the service: `files` assigns them to poses and cycles, `upload` sends them."""
