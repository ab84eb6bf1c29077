"""Sessions, targets and robots by what people call them: id, name, form, or the id on a print."""

from .finding import (
    check_target,
    existing_session,
    find_or_make_session,
    find_or_make_target,
    find_or_make_targets,
    find_robot,
    find_session,
    find_target,
    target_of_session,
)

__all__ = [
    "check_target",
    "existing_session",
    "find_or_make_session",
    "find_or_make_target",
    "find_or_make_targets",
    "find_robot",
    "find_session",
    "find_target",
    "target_of_session",
]
