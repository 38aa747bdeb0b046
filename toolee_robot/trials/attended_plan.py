"""What a plan must be to be done with a person: on a robot, or in a rehearsal that a person is led through."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from toolee_robot.trials.plan import TrialPlan

NOT_ON_A_ROBOT = {
    "perfect_perception": "it gets the tool's true pose, which only a simulation knows",
    "icp": "it is told the tool's own shape, which nobody has measured",
}
"""Arms that a robot cannot have, and why."""
SIMULATED = {
    "--perfect-perception": NOT_ON_A_ROBOT["perfect_perception"],
    "--nail": "list it in `nails`",
}
"""Options that a plan with a person cannot have, and why."""


def option(options: Sequence[str], name: str) -> str | None:
    """The value of an option.

    Args:
        options: Options of a command, `--name value` or `--name=value`.
        name: Its name, such as `--station`.

    Returns:
        The value; None where the option is not given.
    """
    for given, value in zip(options, [*options[1:], None], strict=False):
        if given == name:
            return value
        if given.startswith(f"{name}="):
            return given.removeprefix(f"{name}=")
    return None


def why_not_attended(plan: TrialPlan) -> str | None:
    """What keeps a person from being led through a plan.

    Args:
        plan: The plan.

    Returns:
        The field and the reason; None where nothing does.
    """
    if option(plan.options, "--station") is None:
        return "attended: options name no station file, so that nobody knows what a person hands over"
    for arm in plan.arms:
        if reason := NOT_ON_A_ROBOT.get(arm):
            return f"arms: {arm} makes no sense on a robot: {reason}"
    for name, reason in SIMULATED.items():
        if option(plan.options, name) is not None or name in plan.options:
            return f"options: {name} with a person: {reason}"
    if plan.errors != "nominal" or plan.sweep:
        return "errors, sweep: errors are drawn in a simulation; a station has its own, so leave them out"
    return None
