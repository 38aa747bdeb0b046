"""Faults of RTDE: packets and variables."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from toolee_robot.errors import UserError
from toolee_robot.sim_backend.ur_controller.faults.hooks import Count, HookGroup, hook
from toolee_robot.sim_backend.ur_controller.server.rtde import RtdeSession
from toolee_robot.sim_backend.ur_controller.server.rtde_inputs import INPUTS
from toolee_robot.sim_backend.ur_controller.server.rtde_variables import OUTPUTS

if TYPE_CHECKING:
    from toolee_robot.sim_backend.ur_controller.controller import Controller


class RtdeFaultHooks(HookGroup):
    """Hooks for faults of the RTDE server.

    Args:
        controller: The controller.
    """

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._elsewhere = object()  # owner of the variables that `own` claims

    def end(self) -> None:
        """End all RTDE faults."""
        controller = self._controller
        controller.outputs.missing.clear()
        controller.outputs.not_a_number.clear()
        controller.outputs.frozen_timestamp = None
        controller.inputs.release(self._elsewhere)
        controller.rtde_faults.drop_after = None

    @hook
    def skip(self, packets: Count) -> None:
        """Omit the next data packets to each client."""
        for _, session in self._controller.ports["rtde"].clients:
            if isinstance(session, RtdeSession):
                session.skip(packets)

    @hook
    def handshake_drop(self, packets: Annotated[int, Field(ge=1)], reset: bool = False) -> None:
        """Drop the next client in its handshake.

        Args:
            packets: Number of packets that it may send before.
            reset: Whether to close the connection with RST instead of FIN.
        """
        self._controller.rtde_faults.drop_after, self._controller.rtde_faults.reset = packets, reset

    @hook
    def own(self, variables: list[str]) -> None:
        """Claim input variables, so that clients that request them get IN_USE.

        Raises:
            UserError: There is no such input variable.
        """
        for name in variables:
            if name not in INPUTS:
                raise UserError(f"no input variable {name!r}", code="user.unknown_variable")
            self._controller.inputs.owners[name] = self._elsewhere

    @hook
    def missing(self, variables: list[str]) -> None:
        """Hide output variables, so that clients that request them get NOT_FOUND."""
        self._controller.outputs.missing.update(_known(variables))

    @hook
    def nan(self, variables: list[str], ticks: Count = 1) -> None:
        """Report NaN.

        Args:
            variables: Output variables of doubles.
            ticks: Number of ticks.
        """
        self._controller.outputs.not_a_number.update(dict.fromkeys(_known(variables), ticks + 1))

    @hook
    def freeze_timestamp(self, frozen: bool = True) -> None:
        """Freeze the timestamp of the data, which continue to be sent."""
        self._controller.outputs.frozen_timestamp = self._controller.robot.timestamp if frozen else None


def _known(variables: list[str]) -> list[str]:
    for name in variables:
        if name not in OUTPUTS:
            raise UserError(f"no output variable {name!r}", code="user.unknown_variable")
    return variables
