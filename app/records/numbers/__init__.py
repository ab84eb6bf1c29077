"""Numbers of documents with as many digits as their use supports, by their uncertainties and by the fields' names."""

from app.records.numbers.field_names import DH_PARAMETERS
from app.records.numbers.json_text import encode, encode_record, rounded

__all__ = ["DH_PARAMETERS", "encode", "encode_record", "rounded"]
