"""The overlay of a measurement: its image with what was found in it, the reason and the advice; and thumbnails.

All sizes follow from the width of the output, never from that of the original.
"""

from app.reports.overlay.content import Axis, OverlayContent, Points, Statement, Verdict
from app.reports.overlay.drawing import draw_overlay
from app.reports.overlay.encoding import MediaType, encode_drawing
from app.reports.overlay.thumbnail import THUMBNAIL_PX, draw_thumbnail

__all__ = [
    "THUMBNAIL_PX",
    "Axis",
    "MediaType",
    "OverlayContent",
    "Points",
    "Statement",
    "Verdict",
    "draw_overlay",
    "draw_thumbnail",
    "encode_drawing",
]
