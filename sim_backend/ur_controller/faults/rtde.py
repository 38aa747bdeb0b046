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
    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._elsewhere = object()  # owner of the registers that are "in use"

    def end(self) -> None:
        controller = self._controller
        controller.outputs.missing.clear()
        controller.outputs.not_a_number.clear()
        controller.outputs.frozen_timestamp = None
        controller.inputs.release(self._elsewhere)
        controller.rtde_faults.drop_after = None

    @hook
    def skip(self, packets: Count) -> None:
        """The next so many data packets are not sent, to any client."""
        for _, session in self._controller.ports["rtde"].clients:
            if isinstance(session, RtdeSession):
                session.skip(packets)

    @hook
    def handshake_drop(self, packets: Annotated[int, Field(ge=1)], reset: bool = False) -> None:
        """The next client is dropped when it has sent so many packets."""
        self._controller.rtde_faults.drop_after, self._controller.rtde_faults.reset = packets, reset

    @hook
    def own(self, variables: list[str]) -> None:
        """These input variables belong to someone else; clients that ask for them get IN_USE."""
        for name in variables:
            if name not in INPUTS:
                raise UserError(f"no input variable {name!r}")
            self._controller.inputs.owners[name] = self._elsewhere

    @hook
    def missing(self, variables: list[str]) -> None:
        """Clients that ask for these output variables get NOT_FOUND."""
        self._controller.outputs.missing.update(_known(variables))

    @hook
    def nan(self, variables: list[str], ticks: Count = 1) -> None:
        """These output variables (of doubles) read NaN for so many ticks."""
        self._controller.outputs.not_a_number.update(dict.fromkeys(_known(variables), ticks + 1))

    @hook
    def freeze_timestamp(self, frozen: bool = True) -> None:
        """Data goes on, its timestamp does not."""
        self._controller.outputs.frozen_timestamp = self._controller.robot.timestamp if frozen else None


def _known(variables: list[str]) -> list[str]:
    for name in variables:
        if name not in OUTPUTS:
            raise UserError(f"no output variable {name!r}")
    return variables
