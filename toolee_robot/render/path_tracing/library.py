"""Mitsuba, imported when it is first needed: it is an extra."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from toolee_robot.errors import UserError

_VARIANT = "scalar_rgb"
"""The variant that needs no compiler; it gives the same bytes with any number of threads."""


@lru_cache(maxsize=1)
def mitsuba() -> Any:
    """The module, with its variant chosen and one thread a process: a run has a process for each core it may use.

    Returns:
        The module `mitsuba`.

    Raises:
        UserError: It is not installed.
    """
    try:
        import drjit
        import mitsuba as mi
    except ImportError as error:
        raise UserError(
            f"--renderer mitsuba needs Mitsuba 3 ({error}): run `python -m pip install -e '.[evaluate]'` in the "
            "repository",
            code="user.missing_package",
        ) from error
    mi.set_variant(_VARIANT)
    drjit.set_thread_count(1)
    return mi
