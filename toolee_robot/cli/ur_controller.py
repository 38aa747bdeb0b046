"""`toolee ur-controller`: stand-in of a Universal Robots controller for programs that use ur_rtde."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.markup import escape

from toolee_robot.cli.options import Flag
from toolee_robot.sim_backend.ur_controller.profile import ProfileName, profile

METRES_PER_SECOND, NEWTONS, RADIANS, WATTS, MOMENTUM, SECONDS, DECELERATION = (
    tyro.conf.arg(metavar=unit, help_behavior_hint="") for unit in ("M/S", "N", "RAD", "W", "KG*M/S", "S", "RAD/S2")
)


@dataclass(frozen=True)
class UrController:
    """Stand in for a UR controller: ur_rtde and other clients connect to it as to a robot. Ctrl-C ends it.

    Example: toolee ur-controller --model UR10e --host 127.0.0.3

    Serves RTDE (30004), the dashboard (29999), the script ports (30001 to 30003), and a fault port; runs the control
    script that clients upload. Behind it are ideal joints. Only loopback addresses; docs/reference/ur_controller.md.
    """

    model: Literal["UR10", "UR10e"] = "UR10"
    """UR10: CB3, PolyScope 3.15, 125 Hz. UR10e: e-Series, PolyScope 5.11, 500 Hz."""
    host: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = "127.0.0.2"
    """A loopback address; every robot on this machine needs its own (127.0.0.2, 127.0.0.3, ...)."""
    fault_port: Annotated[int, tyro.conf.arg(metavar="PORT")] = 30020
    """Port for fault injection: one JSON object per line."""
    speed_slider: Annotated[float, tyro.conf.arg(metavar="0..1")] = 1.0
    """Position of the speed slider."""
    local: Flag = False
    """Local control instead of remote control (e-Series)."""
    safeguard_resumes: Flag = False
    """Closing the safeguard resumes the program that it paused, as on a CB3 without a safeguard reset input."""
    off: Flag = False
    """Start with the arm switched off: clients must power it on and release the brakes."""
    profile: Annotated[ProfileName, tyro.conf.arg(metavar="ideal|harsh")] = "ideal"
    """How the controller follows, measures and stops: exactly, or as one of the model's generation."""
    seed: int = 0
    """Seed of the sensors' noise in the harsh profile."""
    force_limit: Annotated[float | None, NEWTONS] = None
    """Force on the flange, smoothed over 20 ms, that triggers a protective stop, instead of the profile's."""
    following_error: Annotated[float | None, RADIANS] = None
    """Deviation of a joint from its set-point that triggers a protective stop, instead of the profile's."""
    tcp_speed_limit: Annotated[float | None, METRES_PER_SECOND] = None
    """Speed of the TCP that triggers a protective stop, instead of the profile's."""
    power_limit: Annotated[float | None, WATTS] = None
    """Power on the environment that triggers a protective stop, instead of the profile's."""
    momentum_limit: Annotated[float | None, MOMENTUM] = None
    """Momentum of the arm that triggers a protective stop, instead of the profile's."""
    lag: Annotated[float | None, SECONDS] = None
    """Lag of servoj behind its targets at a gain of 1200 and a lookahead of 0.03 s, instead of the profile's."""
    stop_deceleration: Annotated[float | None, DECELERATION] = None
    """Deceleration of the fastest joint in protective, safeguard and emergency stops, instead of the profile's."""
    real_time_factor: Annotated[float, tyro.conf.arg(metavar="0.05..1")] = 1.0
    """Rate of the robot's time relative to wall-clock time; clients must use the same."""

    def run(self) -> int:
        from toolee_robot.sim_backend.ur_controller.controller import Controller, ControllerOptions
        from toolee_robot.sim_backend.ur_controller.process import resting_joints
        from toolee_robot.sim_backend.ur_controller.robot.plant import MODELS

        console = Console(highlight=False)
        begin = time.monotonic()

        def log(line: str) -> None:
            console.print(f"[dim]{time.monotonic() - begin:9.3f}[/dim]  {escape(line)}", soft_wrap=True)

        given: dict[str, Any] = {
            "force": self.force_limit,
            "following_error": self.following_error,
            "tcp_speed": self.tcp_speed_limit,
            "power": self.power_limit,
            "momentum": self.momentum_limit,
        }
        chosen = profile(self.profile, MODELS[self.model].e_series)
        limits = replace(chosen.limits, **{name: value for name, value in given.items() if value is not None})
        stops = chosen.stops
        if (given_stop := self.stop_deceleration) is not None:
            stops = replace(stops, protective=given_stop, safeguard=given_stop, emergency=given_stop)
        options = ControllerOptions(
            model=self.model,
            host=self.host,
            fault_port=self.fault_port,
            speed_slider=self.speed_slider,
            remote=not self.local,
            safeguard_resumes=self.safeguard_resumes or None,
            powered=not self.off,
            profile=self.profile,
            seed=self.seed,
            limits=limits,
            lag=self.lag,
            stops=stops,
            real_time_factor=self.real_time_factor,
        )
        controller = Controller(options, resting_joints, log)
        try:
            controller.listen()
            model = controller.robot.model
            version = ".".join(str(number) for number in controller.robot.identity.version)
            console.print(
                f"[bold]{model.name}[/bold], controller software {version}, {model.rate:.0f} Hz, "
                f"{self.profile} profile, on {self.host}"
            )
            for port in (*controller.ports.values(), controller.fault_port):
                console.print(f"  {port.number}  {port.name}")
            console.print("[dim]Ctrl-C ends it; end its clients first.[/dim]")
            controller.run(realtime=True)
        except KeyboardInterrupt:
            statistics = controller.schedule.statistics
            console.print(
                f"\nEnded after {statistics.ticks} ticks: {statistics.late} late, at worst "
                f"{1e3 * statistics.worst_late:.1f} ms; {statistics.slipped} slipped; "
                f"{1e3 * statistics.busy / max(1, statistics.ticks):.2f} ms of work a tick"
            )
        return 0


COMMANDS = {"": UrController}
