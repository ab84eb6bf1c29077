"""Bytes to a grey array: what the file is, whether it is whole, and its pixels.

`read_header` looks at magic bytes and header only, in pure Python; `check_whole` walks the file's structure;
`decode` does both and then lets OpenCV decode. Orientation, of EXIF and of TIFF, is ignored: pixels are the sensor's.
"""

from core.image.decoding import decode
from core.image.header import DEFAULT_MAX_PIXELS, check_pixels, check_whole, read_header
from core.image.layout import ImageHeader
from core.image.preview import Preview, decode_preview

__all__ = [
    "DEFAULT_MAX_PIXELS",
    "ImageHeader",
    "Preview",
    "check_pixels",
    "check_whole",
    "decode",
    "decode_preview",
    "read_header",
]
