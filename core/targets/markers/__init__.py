"""Markers of ArUco and AprilTag dictionaries: sampling of their bits, and the nearest marker."""

from core.targets.markers.bit_sampling import DecodedMarkers, decode_markers
from core.targets.markers.dictionary import (
    MarkerDictionary,
    code_of,
    marker_bits,
    marker_codes,
    nearest_markers,
)
from core.targets.markers.small_markers import decode_small_markers
from core.targets.markers.square_places import places_in_squares

__all__ = [
    "DecodedMarkers",
    "MarkerDictionary",
    "code_of",
    "decode_markers",
    "decode_small_markers",
    "marker_bits",
    "marker_codes",
    "nearest_markers",
    "places_in_squares",
]
