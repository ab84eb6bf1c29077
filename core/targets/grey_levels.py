"""The levels that a picture's camera has."""

from __future__ import annotations

import numpy as np
from jaxtyping import Shaped

_BIT_DEPTHS = (10, 12, 14, 16)


def largest_level(image: Shaped[np.ndarray, "h w"]) -> float:
    """Return the level at which a picture's camera cuts off white; 16 bits may hold 10, 12 or 14, at either end."""
    if image.dtype == np.uint8:
        return 255.0
    largest = int(image.max())
    ends = {((1 << bits) - 1) << shift for bits in _BIT_DEPTHS for shift in (0, 16 - bits)}
    return float(largest) if largest in ends else 65535.0
