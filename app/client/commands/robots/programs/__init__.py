"""Points of robot programs: read as commanded poses of the flange, and written back with other numbers.

KUKA's KRL, ABB's RAPID, Universal Robots' URScript and FANUC's listings of TP programs.
"""

from .languages import Controller, controller_of
from .program import Program, ProgramRefused, read_program

__all__ = [
    "Controller",
    "Program",
    "ProgramRefused",
    "controller_of",
    "read_program",
]
