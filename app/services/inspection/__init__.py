"""Checks of an installation, one module per subject; no check changes anything.

`gridpose doctor` prints them, the System page shows those that take no time.
"""

from app.services.inspection.check_result import CheckResult, State, guarded
from app.services.inspection.quick import inspect_quickly

__all__ = ["CheckResult", "State", "guarded", "inspect_quickly"]
