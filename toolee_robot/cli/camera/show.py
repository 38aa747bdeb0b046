"""`toolee camera show`: what a camera is and sees, and what to enter into the station file."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from toolee_robot.cli.camera.options import CameraOptions
from toolee_robot.cli.output import json_line
from toolee_robot.errors import TooleeError
from toolee_robot.station import CameraConfig

if TYPE_CHECKING:
    from toolee_robot.devices.cameras import CameraProfile, StreamedCamera
    from toolee_robot.devices.cameras.lens_choice import ChosenLens
    from toolee_robot.hal import Clock


@dataclass(frozen=True)
class Show(CameraOptions):
    """Open a camera, say what it is, and print what the station file needs to know of it.

    Example: toolee camera show --driver realsense --serial 832112070123 --size 848 480 --picture seen.png

    A lens of the station file that a job would refuse keeps nobody from looking: the camera's own is taken, and said.

    Exit code 0: it gives frames; 1: it does not; 2: invalid input.
    """

    picture: Annotated[Path | None, tyro.conf.arg(metavar="OUT.png", help_behavior_hint="")] = None
    """Also write what it sees, colour and depth side by side."""

    def run(self) -> int:
        from toolee_robot.devices.cameras.picture import write_picture
        from toolee_robot.runtime.clock import HostClock

        console = Console(stderr=self.json, highlight=False)
        config, clock = self.camera(), HostClock()
        with console.status("opening the camera"), ExitStack() as stack:
            camera, refused = self._entered(stack, clock)
            frame = camera.newer(0.0)
            age = clock.now() - frame.stamp
            profile, chosen = camera.profile, camera.lens
        if refused is not None:
            config = replace(config, distortion=None, intrinsics_record=None, lens_serial=None)
            told = f"[yellow]Without the station file's lens, which a job refuses:[/yellow] {escape(refused)}\n"
            console.print(told, soft_wrap=True)
        k = frame.intrinsics
        known = float((frame.depth > 0).mean())
        table = Table.grid(padding=(0, 2, 0, 0))
        facts = {
            "model": profile.model,
            "serial": profile.serial,
            "firmware": profile.firmware or "not told",
            "image": f"{k.width}x{k.height} at {profile.fps:g} Hz",
            "lens": chosen.words,
            "depth": _registered(profile, chosen),
            "exposure": {True: "automatic", False: "fixed", None: "not told"}[profile.auto_exposure],
            "newest frame": f"{age * 1e3:.0f} ms old, depth known for {known:.0%} of it",
        }
        for name, value in facts.items():
            table.add_row(name, value)
        console.print(table)
        instead = "" if refused is None else ", to open this camera as it is"
        console.print(f"\nFor the station file{instead}:\n")
        console.print(_station_lines(config, profile, chosen), soft_wrap=True, markup=False)
        if self.picture is not None:
            write_picture(self.picture, frame)
            console.print(f"\nWritten: {self.picture}", soft_wrap=True)
        if self.json:
            intrinsics = {"fx": k.fx, "fy": k.fy, "cx": k.cx, "cy": k.cy, "width": k.width, "height": k.height}
            lens = chosen.lens
            distortion = {
                "model": lens.model, "coefficients": lens.coefficients, "from": chosen.source,
                "largest_displacement": lens.largest_displacement() if lens.known else None,
            }  # fmt: skip
            record = {"intrinsics": intrinsics, "distortion": distortion, "known_depth": known, "refused_lens": refused}
            print(json_line({**facts, **record}), flush=True)
        return 0

    def _entered(self, stack: ExitStack, clock: Clock) -> tuple[StreamedCamera, str | None]:
        """Open the camera by the station file's lens; by its own where that one is refused, with the reason."""
        from toolee_robot.devices.cameras.lens_choice import REFUSED

        try:
            return stack.enter_context(self.open(clock)), None
        except TooleeError as error:
            if error.code not in {*REFUSED, "config.intrinsics_rehearsed"}:
                raise
            return stack.enter_context(self.open(clock, own_lens=True)), str(error)


def _registered(profile: CameraProfile, chosen: ChosenLens) -> str:
    if profile.depth is None:
        return "registered by the device" + (", undistorted with the colour" if chosen.lens.distorts else "")
    k = profile.depth.intrinsics
    return f"{k.width}x{k.height}, registered to the colour here"


def _station_lines(config: CameraConfig, profile: CameraProfile, chosen: ChosenLens) -> str:
    device = config.device
    assert device is not None
    lines = ["camera:", *_lens_lines(config, chosen)]
    lines += [
        "  device:",
        f"    driver: {device.driver}",
        f'    serial: "{profile.serial}"',
        f"    fps: {profile.fps:.0f}",
        "    least_range:       # [m], of this mode, from the camera's data sheet",
    ]
    if device.exposure is not None:
        lines.append(f"    exposure: {device.exposure:g}")
    if device.camera_class is not None:
        lines.append(f"    camera_class: {device.camera_class}")
    if device.folder is not None:
        lines.append(f"    folder: {device.folder}")
    return "\n".join(lines)


def _lens_lines(config: CameraConfig, chosen: ChosenLens) -> list[str]:
    from toolee_robot.devices.cameras.lens_choice import LensSource

    recorded = chosen.source is LensSource.RECORDING and config.intrinsics_record is not None
    if chosen.source is LensSource.RECORD or recorded:
        return [f"  intrinsics: {config.intrinsics_record}"]
    k, distortion = chosen.lens.intrinsics, config.distortion
    lines = [
        f"  fx: {k.fx:.3f}",
        f"  fy: {k.fy:.3f}",
        f"  cx: {k.cx:.3f}",
        f"  cy: {k.cy:.3f}",
        f"  width: {k.width}",
        f"  height: {k.height}",
    ]
    if distortion is not None:
        lines.append(f"  distortion: {list(distortion)}")
    elif not chosen.lens.known:
        lines.append("  distortion:          # by `toolee calibrate intrinsics`; [0, 0, 0, 0] of undistorted images")
    return lines
