"""The files of a watched folder: `scan` lists them, `intact` checks their structure, `metadata` reads what is said of
them.
"""

from .intact import why_incomplete
from .metadata import TABLE, ImageMetadata, MetadataError, PoseTable, read_sidecar, read_table, sidecar_of
from .scan import Found, Settling, in_natural_order, list_folder, signature_of

__all__ = [
    "TABLE",
    "Found",
    "ImageMetadata",
    "MetadataError",
    "PoseTable",
    "Settling",
    "in_natural_order",
    "list_folder",
    "read_sidecar",
    "read_table",
    "sidecar_of",
    "signature_of",
    "why_incomplete",
]
