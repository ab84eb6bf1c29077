"""Plots as SVG, and overlays and thumbnails of images (`overlay`).

Each module has the plain values one plot shows, and the function that draws them.

Nothing is estimated here. matplotlib is loaded by the process that draws, never by the one that serves.
"""

import logging

# Where its own folder may not be written, as in a container, matplotlib says so in prose; one in the system's
# temporary folder serves as well, and the service's log is JSON.
logging.getLogger("matplotlib").setLevel(logging.ERROR)
