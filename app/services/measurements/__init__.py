"""Measurements: an image is received, stored permanently, and computed by the runner that claims its job."""

from app.services.measurements.corrections import correct_measurement, delete_measurement
from app.services.measurements.quota import bytes_today, check_quota
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
from app.services.measurements.upload import (
    Metadata,
    TargetChoice,
    UploadResult,
    check_target,
    find_missing,
    is_stored,
    sanitise_filename,
    store_image,
)

__all__ = [
    "MeasurementDetail",
    "Metadata",
    "TargetChoice",
    "UploadResult",
    "bytes_today",
    "check_quota",
    "check_target",
    "correct_measurement",
    "delete_measurement",
    "find_missing",
    "find_original",
    "get_measurement",
    "get_points",
    "get_thumbnail",
    "has_image_of_size",
    "is_stored",
    "list_measurements",
    "open_image",
    "reprocess_session",
    "retry_measurement",
    "sanitise_filename",
    "sought_target",
    "store_image",
]
