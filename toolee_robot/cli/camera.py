"""Find, show and record an RGB-D camera.

Example: toolee camera list
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.markup import escape
from rich.table import Table

from toolee_robot.cli.output import STATION, JsonOption
from toolee_robot.errors import TooleeError, UserError

if TYPE_CHECKING:
    from toolee_robot.devices.cameras import CameraProfile, StreamedCamera
    from toolee_robot.devices.cameras.lens_choice import ChosenLens
    from toolee_robot.hal import Clock
    from toolee_robot.station import CameraConfig

_UNKNOWN_RANGE = 1e-3
"""Stands in for the least range of a camera that no station file describes, where nothing asks for it [m]."""


@dataclass(frozen=True, kw_only=True)
class CameraOptions(JsonOption):
    """Which camera: a station file's, a recording, or one by driver and serial number."""

    config: Annotated[Path | None, STATION] = None
    """The station file, whose camera.device is opened."""
    recording: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Instead: a recording of `toolee camera record`, played."""
    driver: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = None
    """Instead: the name of a driver, such as realsense, with --serial."""
    serial: Annotated[str | None, tyro.conf.arg(metavar="NUMBER", help_behavior_hint="")] = None
    """Serial number of the camera."""
    size: Annotated[tuple[int, int], tyro.conf.arg(metavar="W H")] = (848, 480)
    """With --driver: size of the colour image [px]."""
    fps: int = 30
    """With --driver: frames per second."""
    exposure: Annotated[float | None, tyro.conf.arg(metavar="S", help_behavior_hint="")] = None
    """With --driver: exposure of the colour image [s]. If left out, the camera chooses it."""

    def camera(self) -> CameraConfig:
        """What the station file, or the options, say of the camera."""
        from toolee_robot.station import CameraDevice, load_station, sim_station

        given = [self.config is not None, self.recording is not None, self.driver is not None]
        if sum(given) != 1:
            message = "which camera? Give one of --station YAML, --recording DIR, or --driver NAME with --serial NUMBER"
            raise UserError(message)
        if self.config is not None:
            return load_station(self.config).camera
        if self.recording is not None:
            from toolee_robot.devices.cameras.recording import open_recording

            recording = open_recording(self.recording)
            device = CameraDevice("recorded", recording.serial, _UNKNOWN_RANGE, folder=str(self.recording))
            return replace(sim_station().camera, device=device)
        if self.driver is None or self.serial is None:
            raise UserError("--driver needs --serial, which `toolee camera list` shows")
        device = CameraDevice(self.driver, self.serial, _UNKNOWN_RANGE, self.fps, self.exposure)
        return replace(sim_station().camera, device=device, width=self.size[0], height=self.size[1])

    def open(self, clock: Clock, *, own_lens: bool = False) -> StreamedCamera:
        """The camera, not yet entered: by the station file's lens if it states one, or by its own."""
        from toolee_robot.stations.camera import open_camera

        config = self.camera()
        return open_camera(config, clock, check_intrinsics=config.distortion is not None and not own_lens)


@dataclass(frozen=True)
class ListCameras(JsonOption):
    """List the cameras that are connected, and the drivers.

    Example: toolee camera list

    The cameras are RealSense and Orbbec ones. A station file may name any of the drivers. Exit code 0, even without a
    camera.
    """

    def run(self) -> int:
        from toolee_robot.devices.cameras import orbbec, realsense
        from toolee_robot.stations.camera import camera_drivers

        console = self.console
        found: list[dict[str, str]] = []
        for maker, describe in (("RealSense", realsense.describe_connected), ("Orbbec", orbbec.describe_connected)):
            try:
                cameras = describe()
            except UserError as error:
                console.print(f"[yellow]{escape(str(error))}[/yellow]")
                continue
            found += cameras
            if not cameras:
                console.print(f"No {maker} is connected.")
        if found:
            table = Table("model", "serial", "firmware", "port", box=None, pad_edge=False)
            for camera in found:
                table.add_row(camera["model"], camera["serial"], camera["firmware"], camera["port"])
            console.print(table)
        drivers = camera_drivers()
        console.print(f"Drivers: {', '.join(drivers)}. List other cameras with their maker's software.")
        self.tell({"cameras": found, "drivers": drivers})
        return 0


@dataclass(frozen=True)
class Show(CameraOptions):
    """Show what a camera is and sees, for the station file.

    Example: toolee camera show --driver realsense --serial 832112070123 --size 848 480 --picture seen.png

    If a job would refuse the station file's lens, the command uses the camera's own lens and says so.

    Exit code 0: the camera gives frames; 1: it does not; 2: invalid input.
    """

    picture: Annotated[Path | None, tyro.conf.arg(metavar="OUT.png", help_behavior_hint="")] = None
    """Also write what it sees, colour and depth side by side."""

    def run(self) -> int:
        from toolee_robot.devices.cameras.recording import write_picture
        from toolee_robot.runtime.clock import HostClock

        console = self.console
        config, clock = self.camera(), HostClock()
        with console.status("opening the camera"), ExitStack() as stack:
            camera, refused = self._entered(stack, clock)
            frame = camera.newer(0.0)
            age = clock.now() - frame.stamp
            profile, chosen = camera.profile, camera.lens
        if refused is not None:
            config = replace(config, distortion=None)
            told = f"[yellow]Shown without the station file's lens. A job refuses it:[/yellow] {escape(refused)}\n"
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
            "newest frame": f"{age * 1e3:.0f} ms old, depth known in {known:.0%} of the pixels",
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
        lens = chosen.lens
        self.tell(
            {
                **facts,
                "intrinsics": {"fx": k.fx, "fy": k.fy, "cx": k.cx, "cy": k.cy, "width": k.width, "height": k.height},
                "distortion": {
                    "model": lens.model,
                    "coefficients": lens.coefficients,
                    "from": chosen.source,
                    "largest_displacement": lens.largest_displacement() if lens.known else None,
                },
                "known_depth": known,
                "refused_lens": refused,
            }
        )
        return 0

    def _entered(self, stack: ExitStack, clock: Clock) -> tuple[StreamedCamera, str | None]:
        """Open the camera by the station file's lens; by its own where that one is refused, with the reason."""
        from toolee_robot.devices.cameras.lens_choice import REFUSED

        try:
            return stack.enter_context(self.open(clock)), None
        except TooleeError as error:
            if error.code not in REFUSED:
                raise
            return stack.enter_context(self.open(clock, own_lens=True)), str(error)


@dataclass(frozen=True)
class Record(CameraOptions):
    """Record the frames of a camera, as a job would get them.

    Example: toolee camera record --station lab.yaml --out frames --seconds 5

    Frames are undistorted, registered and time-stamped. The folder can be played (`--recording frames`, or the driver
    `recorded` in a station file), and `toolee estimate --bop frames` finds the tools in it. Ctrl-C ends the recording,
    which is kept.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """A new folder."""
    seconds: float = 5.0
    """How long."""
    every: Annotated[float, tyro.conf.arg(metavar="S")] = 0.0
    """Record one frame in so many seconds, with a bell in the terminal; 0: every frame."""

    def run(self) -> int:
        from toolee_robot.devices.cameras.recording import RecordingWriter
        from toolee_robot.runtime.clock import HostClock

        if not 0.0 < self.seconds < inf:
            raise UserError(f"--seconds {self.seconds:g}: give a time above 0")
        if self.every < 0:
            raise UserError(f"--every {self.every:g}: give a time above 0, or leave it out")
        console = self.console
        clock, count, stamp, due = HostClock(), 0, 0.0, 0.0
        with self.open(clock) as camera:
            profile = camera.profile
            # What is played and does not say whether it is undistorted does not say so afterwards, either.
            undistorted = camera.lens.lens.known or profile.undistorted
            writer = RecordingWriter(
                self.out, profile.model, profile.serial, profile.fps, camera.intrinsics, undistorted=undistorted
            )
            end = clock.now() + self.seconds
            with writer, console.status("recording"):
                while clock.now() < end:
                    frame = camera.newer(stamp)
                    stamp = frame.stamp
                    if stamp < due:
                        continue
                    due = stamp + self.every
                    writer.add(frame)
                    count += 1
                    if self.every:
                        console.bell()
        rate = count / self.seconds
        console.print(f"{count} frames in {self.out}, {rate:.1f} of {profile.fps:g} a second", soft_wrap=True)
        self.tell({"folder": str(self.out), "frames": count, "rate": rate})
        return 0


COMMANDS = {"camera": {"list": ListCameras, "show": Show, "record": Record}}


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
        "    least_range:       # [m], for this mode, from the camera's data sheet",
    ]
    if device.exposure is not None:
        lines.append(f"    exposure: {device.exposure:g}")
    if device.folder is not None:
        lines.append(f"    folder: {device.folder}")
    return "\n".join(lines)


def _lens_lines(config: CameraConfig, chosen: ChosenLens) -> list[str]:
    k, distortion = chosen.lens.intrinsics, config.distortion
    lines = [f"  {name}: {getattr(k, name):.3f}" for name in ("fx", "fy", "cx", "cy")]
    lines += [f"  width: {k.width}", f"  height: {k.height}"]
    if distortion is not None:
        lines.append(f"  distortion: {list(distortion)}")
    elif not chosen.lens.known:
        lines.append("  distortion:          # k1, k2, p1, p2 by OpenCV or ROS; [0, 0, 0, 0] for undistorted images")
    return lines
