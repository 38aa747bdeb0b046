"""True state of a controller as plain numbers and words: the answer of the fault port's `state`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from toolee_robot.sim_backend.ur_controller.robot.safety.system import RobotMode, SafetyMode

if TYPE_CHECKING:
    from toolee_robot.sim_backend.ur_controller.controller import Controller


def describe(controller: Controller) -> dict[str, Any]:
    """The answer of the `state` hook."""
    robot = controller.robot
    machine, safety, program, statistics = robot.machine, robot.safety, robot.program, controller.schedule.statistics
    return {
        "model": robot.model.name,
        "profile": machine.profile.name,
        "timestamp": robot.timestamp,
        "stamp": controller.clock.now(),
        "tick": robot.ticks,
        "q": robot.plant.q.tolist(),
        "qd": robot.plant.qd.tolist(),
        "q_target": machine.q_target.tolist(),
        "qd_target": machine.qd_target.tolist(),
        "tcp_pose": robot.reading.tcp_pose,
        "tcp_force": robot.reading.tcp_force.tolist(),
        "moving": machine.moving,
        "robot_mode": RobotMode(safety.robot_mode).name,
        "safety_mode": SafetyMode(safety.mode).name,
        "safety_reason": safety.reason,
        "deviation_ratio": safety.detection.deviation_ratio,
        "collision_ratio": safety.detection.collision_ratio,
        "remote": safety.remote,
        "program_state": program.state.name,
        "program_name": program.name,
        "program_error": program.last_error,
        "uploads": program.uploads,
        "payload": machine.payload,
        "payload_cog": list(machine.payload_cog),
        "tcp": list(machine.tcp),
        "speed_slider": machine.speed_fraction,
        "popup": robot.popup,
        "messages": [str(said) for _, said in list(robot.messages)[-10:]],
        "clients": {name: len(port.clients) for name, port in controller.ports.items()},
        "ticks": {
            "done": statistics.ticks,
            "late": statistics.late,
            "slipped": statistics.slipped,
            "worst_late": statistics.worst_late,
            "mean_work": statistics.busy / max(1, statistics.ticks),
        },
    }
