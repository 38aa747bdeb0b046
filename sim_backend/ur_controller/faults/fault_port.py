"""The fault port: one JSON object per line in, one per line out. Every hook, and what tests want to know.

{"fault": "drop", "port": "rtde", "reset": true} -> {"ok": true}; a mistake -> {"ok": false, "error": "..."}.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from toolee_robot.sim_backend.ur_controller.faults.hooks import HookGroup, hook
from toolee_robot.sim_backend.ur_controller.faults.network import NetworkFaults
from toolee_robot.sim_backend.ur_controller.faults.queries import Questions
from toolee_robot.sim_backend.ur_controller.faults.robot import RobotFaults
from toolee_robot.sim_backend.ur_controller.faults.rtde import RtdeFaultHooks

if TYPE_CHECKING:
    from toolee_robot.sim_backend.ur_controller.controller import Controller


class Faults:
    """What can be done to a controller from outside. Each hook is a method of a group; its arguments are the request's
    keys.

    Ports are named "rtde", "dashboard", "primary", "secondary", "realtime", or "all".
    """

    def __init__(self, controller: Controller) -> None:
        network = NetworkFaults(controller)
        robot = RobotFaults(controller, network)
        # A reset ends what runs on the robot before the network comes back.
        self._groups = (robot, RtdeFaultHooks(controller), network, Questions(controller))
        self._hooks = {
            name: found for group in (*self._groups, _Reset(self._groups)) for name, found in group.hooks().items()
        }

    def do(self, request: object) -> dict[str, Any]:
        """Carry out one request; never raises."""
        if not isinstance(request, dict) or not isinstance(name := request.get("fault"), str):
            return {"ok": False, "error": 'a request is {"fault": NAME, ...}'}
        if (found := self._hooks.get(name)) is None:
            return {"ok": False, "error": f"no fault {name!r}: choose one of {', '.join(sorted(self._hooks))}"}
        return found({str(key): value for key, value in request.items() if key != "fault"})

    def step(self) -> None:
        """What is over by now ends."""
        for group in self._groups:
            group.step()


class _Reset(HookGroup):
    def __init__(self, groups: Sequence[HookGroup]) -> None:
        self._groups = groups

    @hook
    def reset(self) -> None:
        """All faults off, the robot as it was started: running, no program, normal safety mode. The joints, the
        registers and the connections stay as they are."""
        for group in self._groups:
            group.end()
