"""An identified robot as the files that other programs take: its chain, and what it has beyond it.

`Model` is the answer of `GET .../dh` with the robot's names and limits of joints; `exports_of` gives the files that a
report carries.
"""

from app.analyses.documents.robot_files.error_terms import (
    NoTerms,
    write_angle_table,
    write_terms_csv,
    write_terms_json,
)
from app.analyses.documents.robot_files.exports import CHAIN_FILES, exports_of
from app.analyses.documents.robot_files.model_files import WRITERS, Model, names_of, ranges_of

__all__ = [
    "CHAIN_FILES",
    "WRITERS",
    "Model",
    "NoTerms",
    "exports_of",
    "names_of",
    "ranges_of",
    "write_angle_table",
    "write_terms_csv",
    "write_terms_json",
]
