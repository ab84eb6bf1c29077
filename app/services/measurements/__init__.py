"""Measurements: an image is received, stored permanently, and computed by the runner that claims its job."""

from app.services.measurements.acceptance import (
    Metadata,
    NewMeasurement,
    choose_target,
    recall_targets,
    require_cycle,
    session_targets,
)
from app.services.measurements.corrections import correct_measurement, delete_measurement
from app.services.measurements.gallery import (
    GalleryCounts,
    GalleryFilter,
    ImageState,
    count_gallery,
    list_gallery,
    neighbours,
)
from app.services.measurements.missing import find_missing
from app.services.measurements.quota import bytes_today, check_quota, read_use
from app.services.measurements.reading import (
    MeasurementDetail,
    find_original,
    get_measurement,
    get_points,
    has_image_of_size,
    list_measurements,
    open_image,
    sought_target,
)
from app.services.measurements.retries import reprocess_session, retry_measurement
from app.services.measurements.thumbnails import get_thumbnail
from app.services.measurements.upload import find_upload, store_image

__all__ = [
    "GalleryCounts",
    "GalleryFilter",
    "ImageState",
    "MeasurementDetail",
    "Metadata",
    "NewMeasurement",
    "bytes_today",
    "check_quota",
    "choose_target",
    "correct_measurement",
    "count_gallery",
    "delete_measurement",
    "find_missing",
    "find_original",
    "find_upload",
    "get_measurement",
    "get_points",
    "get_thumbnail",
    "has_image_of_size",
    "list_gallery",
    "list_measurements",
    "neighbours",
    "open_image",
    "read_use",
    "recall_targets",
    "reprocess_session",
    "require_cycle",
    "retry_measurement",
    "session_targets",
    "sought_target",
    "store_image",
]
