"""The hooks of the fault port: one JSON object per line in, one per line out.

{"fault": "drop", "port": "rtde", "reset": true} -> {"ok": true}; an invalid request -> {"ok": false, "error": "..."}.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from toolee_robot.sim_backend.ur_controller.faults.hooks import HookGroup, hook
from toolee_robot.sim_backend.ur_controller.faults.measuring import MeasuringFaults
from toolee_robot.sim_backend.ur_controller.faults.network import NetworkFaults
from toolee_robot.sim_backend.ur_controller.faults.queries import Queries
from toolee_robot.sim_backend.ur_controller.faults.robot import RobotFaults
from toolee_robot.sim_backend.ur_controller.faults.rtde import RtdeFaultHooks

if TYPE_CHECKING:
    from toolee_robot.sim_backend.ur_controller.controller import Controller


class Faults:
    """All hooks of a controller. Each is a method of a group; its arguments are the request's keys.

    Ports are named "rtde", "dashboard", "primary", "secondary", "realtime", or "all".

    Args:
        controller: The controller.
    """

    def __init__(self, controller: Controller) -> None:
        network = NetworkFaults(controller)
        robot = RobotFaults(controller, network)
        # A reset ends the robot's faults before the network's.
        measuring = MeasuringFaults(controller)
        self._groups = (robot, measuring, RtdeFaultHooks(controller), network, Queries(controller))
        self._hooks = {
            name: found for group in (*self._groups, _Reset(self._groups)) for name, found in group.hooks().items()
        }

    def do(self, request: object) -> dict[str, Any]:
        """Execute one request; never raises.

        Args:
            request: The decoded JSON object.

        Returns:
            The answer, a JSON object.
        """
        if not isinstance(request, dict) or not isinstance(name := request.get("fault"), str):
            return {"ok": False, "error": 'a request is {"fault": NAME, ...}'}
        if (found := self._hooks.get(name)) is None:
            return {"ok": False, "error": f"no fault {name!r}: choose one of {', '.join(sorted(self._hooks))}"}
        return found({str(key): value for key, value in request.items() if key != "fault"})

    def step(self) -> None:
        """End the faults whose duration is over."""
        for group in self._groups:
            group.step()


class _Reset(HookGroup):
    """The hook that ends the faults of all groups."""

    def __init__(self, groups: Sequence[HookGroup]) -> None:
        self._groups = groups

    @hook
    def reset(self) -> None:
        """End all faults and restore the robot's initial state: running, no program, normal safety mode.

        Joints, registers and connections stay as they are.
        """
        for group in self._groups:
            group.end()
