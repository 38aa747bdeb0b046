"""Recorded frames, a folder in the BOP layout with stamps that `toolee estimate --bop` reads, and their playback.

`rgb/000000.png` and `depth/000000.png` are the images of frame 0, undistorted and registered; `scene_camera.json` has
for each frame `cam_K` [px], `depth_scale` [mm per unit of the depth image] and `stamp` [s]; `recording.json` says which
camera it was, and whether its lens was known, without which the images are not undistorted (`undistorted`; where it is
missing, nobody knows).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from toolee_robot.devices.cameras.lens import Lens, LensModel
from toolee_robot.devices.cameras.stream import CameraProfile, RawImages
from toolee_robot.errors import NoAnswerError, UserError, words_of
from toolee_robot.hal import Clock
from toolee_robot.runtime.files import read_json, write_atomic
from toolee_robot.runtime.images import read_image
from toolee_robot.types import CameraIntrinsics, RgbdFrame

RECORDING = "recording.json"
"""The file that says which camera it was."""
WRITTEN_EVERY = 30
"""Frames after which a recording that goes on can be read up to here, also after a kill."""
DEPTH_UNIT = 1e-4
"""Unit of recorded depths [m]; 16 bits then reach to 6.55 m, and what is farther is unknown."""


@dataclass(frozen=True)
class Recording:
    """A recording, its images not yet read."""

    folder: Path
    """Where it is."""
    model: str
    """Model of the camera that was recorded."""
    serial: str
    """Its serial number."""
    fps: float
    """Its frames per second."""
    intrinsics: CameraIntrinsics
    """Pinhole model of all images."""
    depth_scale: float
    """Metres per unit of the depth images."""
    undistorted: bool | None
    """Whether the images are undistorted; None where the recording does not say."""
    stamps: tuple[float, ...]
    """Time of each frame on the clock of the recording [s], ascending."""

    def read(self, number: int) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
        """Read the images of a frame.

        Args:
            number: Which one, from 0.

        Returns:
            Colour (H, W, 3), and depth (H, W) in units of `depth_scale`.

        Raises:
            UserError: A file is missing, or no image of the recording's size.
        """
        size = (self.intrinsics.height, self.intrinsics.width)
        paths = [_image(self.folder, name, number) for name in ("rgb", "depth")]
        try:
            bgr, depth = read_image(paths[0], cv2.IMREAD_COLOR), read_image(paths[1])
        except (OSError, ValueError) as error:
            raise UserError(
                f"frame {number} of {self.folder} cannot be read: {words_of(error)}: record again"
            ) from error
        for path, image, shape in ((paths[0], bgr, (*size, 3)), (paths[1], depth, size)):
            if image is None or image.shape != shape:
                raise UserError(f"{path} is not an image of the recording: record again")
        if depth is None or bgr is None or depth.dtype != np.uint16:
            raise UserError(f"{paths[1]} has not 16 bits: record again")
        return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8), np.asarray(depth, np.uint16)


class RecordingWriter:
    """Context manager that writes a recording, which is complete after the context, also after an exception.

    Args:
        folder: A new folder.
        model: Model of the camera.
        serial: Its serial number.
        fps: Its frames per second.
        intrinsics: Pinhole model of all frames.
        undistorted: Whether the frames are undistorted; None where nobody knows.
    """

    def __init__(
        self,
        folder: Path,
        model: str,
        serial: str,
        fps: float,
        intrinsics: CameraIntrinsics,
        *,
        undistorted: bool | None = True,
    ) -> None:
        self._folder, self._intrinsics = folder, intrinsics
        size = {"width": intrinsics.width, "height": intrinsics.height}
        self._camera = {"model": model, "serial": serial, "fps": fps, **size, "undistorted": undistorted}
        self._frames: dict[str, dict[str, Any]] = {}

    def __enter__(self) -> Self:
        """Make the folder.

        Raises:
            UserError: It exists, or cannot be made.
        """
        try:
            self._folder.mkdir(parents=True)
            for name in ("rgb", "depth"):
                (self._folder / name).mkdir()
        except OSError as error:
            message = f"cannot record into {self._folder}: {words_of(error)}; name a new folder"
            raise UserError(message) from error
        write_atomic(self._folder / RECORDING, json.dumps(self._camera, indent=1).encode())
        return self

    def __exit__(self, *_: object) -> None:
        self._write_frames()

    def _write_frames(self) -> None:
        write_atomic(self._folder / "scene_camera.json", json.dumps(self._frames, indent=1).encode())

    def add(self, frame: RgbdFrame) -> None:
        """Write a frame.

        Args:
            frame: The frame, later than the last one, with the recording's intrinsics.

        Raises:
            UserError: It cannot be written.
        """
        number = len(self._frames)
        units = np.rint(np.nan_to_num(frame.depth, nan=0.0, posinf=0.0, neginf=0.0) / DEPTH_UNIT)
        depth = np.where((units > 0) & (units < 2**16), units, 0).astype(np.uint16)
        for name, image in (("rgb", cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2BGR)), ("depth", depth)):
            _, png = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
            write_atomic(_image(self._folder, name, number), png.tobytes())
        self._frames[str(number)] = {
            "cam_K": self._intrinsics.matrix.ravel().tolist(),
            "depth_scale": DEPTH_UNIT * 1e3,
            "stamp": frame.stamp,
        }
        if number % WRITTEN_EVERY == 0:
            self._write_frames()


def open_recording(folder: Path) -> Recording:
    """Read what a recording holds.

    Args:
        folder: A folder that `RecordingWriter` wrote.

    Returns:
        The recording.

    Raises:
        UserError: The folder is no recording; the message names the file.
    """
    camera, frames = _read(folder / RECORDING), _read(folder / "scene_camera.json")
    try:
        entries = [frames[str(number)] for number in range(len(frames))]
        if not entries:
            raise UserError(f"{folder} holds no frame: record again")
        undistorted = camera.get("undistorted")
        if undistorted is not None and not isinstance(undistorted, bool):
            raise ValueError(f"undistorted: {undistorted!r}")
        fx, _, cx, _, fy, cy = (float(value) for value in entries[0]["cam_K"][:6])
        return Recording(
            folder,
            str(camera["model"]),
            str(camera["serial"]),
            float(camera["fps"]),
            CameraIntrinsics(fx, fy, cx, cy, int(camera["width"]), int(camera["height"])),
            float(entries[0]["depth_scale"]) / 1e3,
            undistorted,
            tuple(float(entry["stamp"]) for entry in entries),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        message = f"{folder} is not a recording by `toolee camera record` ({error!r}): record again"
        raise UserError(message) from error


def recording_of(images: Path) -> Recording | None:
    """Find the recording that a folder of images is, or is part of.

    Args:
        images: The folder.

    Returns:
        The recording; None where the images are of none.

    Raises:
        UserError: As `open_recording`.
    """
    folder = images.resolve()
    found = next((place for place in (folder, folder.parent) if (place / RECORDING).exists()), None)
    return None if found is None else open_recording(found)


def _read(path: Path) -> Any:
    try:
        return read_json(path)
    except (OSError, ValueError) as error:
        message = f"cannot read {path}: give the folder of a recording by `toolee camera record`"
        raise UserError(message) from error


def _image(folder: Path, kind: str, number: int) -> Path:
    return folder / kind / f"{number:06d}.png"


class RecordedStream:
    """The `CameraStream` of a recording: each frame once, as fast as it was recorded, from its beginning.

    After the last frame nothing comes any more, as from a camera that hangs.

    Args:
        folder: A folder of `toolee camera record`.
        clock: Clock by which it is played.
    """

    def __init__(self, folder: Path, clock: Clock) -> None:
        self._folder, self._clock = folder, clock
        self._recording: Recording | None = None

    def open(self) -> CameraProfile:
        """Open the recording at its beginning.

        Raises:
            UserError: The folder is no recording.
        """
        recording = self._recording = open_recording(self._folder)
        self._next = 0
        self._begin = self._clock.now() - recording.stamps[0]
        return CameraProfile(
            f"recording of {recording.model}",
            recording.serial,
            Lens(recording.intrinsics, LensModel.NONE if recording.undistorted else LensModel.UNKNOWN),
            recording.fps,
            depth_scale=recording.depth_scale,
            warm_up=0,
            undistorted=recording.undistorted,
        )

    def fetch(self, timeout: float) -> RawImages | None:
        """Wait until the next frame is due.

        Args:
            timeout: Longest wait [s].

        Returns:
            Its images; None if none is due in time.

        Raises:
            UserError: They cannot be read.
            NoAnswerError: The recording is closed.
        """
        recording = self._recording
        if recording is None:
            raise NoAnswerError("the recording is closed: open it again")
        if self._next == len(recording.stamps):
            self._clock.sleep(timeout)
            return None
        stamp = recording.stamps[self._next]
        wait = self._begin + stamp - self._clock.now()
        if wait > timeout:
            self._clock.sleep(timeout)
            return None
        rgb, depth = recording.read(self._next)
        self._clock.sleep(self._begin + stamp - self._clock.now())
        self._next += 1
        return RawImages(rgb, depth, stamp, stamp)

    def close(self) -> None:
        """Close the recording."""
        self._recording = None


def write_picture(path: Path, frame: RgbdFrame) -> None:
    """Write a PNG of a frame: its colour, and its depth from near (red) to far (blue), unknown in black.

    Args:
        path: The file; its folder exists.
        frame: The frame.

    Raises:
        UserError: The file cannot be written.
    """
    known = np.isfinite(frame.depth) & (frame.depth > 0)
    near, far = np.quantile(frame.depth[known], [0.01, 0.99]) if known.any() else (0.0, 1.0)
    share = np.clip((np.nan_to_num(frame.depth) - near) / max(far - near, 1e-6), 0, 1)
    depth = cv2.applyColorMap((255 * (1 - share)).astype(np.uint8), cv2.COLORMAP_TURBO)
    depth[~known] = 0
    both = np.hstack([cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2BGR), depth])
    write_atomic(path, cv2.imencode(".png", both)[1].tobytes())
