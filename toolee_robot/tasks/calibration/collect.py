"""Images of a calibration board, which the arm drives through poses."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from toolee_robot.calibration.board import Board
from toolee_robot.calibration.observation import camera_board, find_board
from toolee_robot.calibration.session import Session, SessionPose
from toolee_robot.control import CollisionWorld, Mode, RobotModel, Supervisor, slowed_to
from toolee_robot.control.planning.transfer import plan_transfer
from toolee_robot.errors import DeviceError, PersonNearError, PlanningError, StaleDataError, UserError
from toolee_robot.frames import Array
from toolee_robot.hal import MotionOutcome, RgbdCamera, Station
from toolee_robot.station import StationConfig
from toolee_robot.types import RgbdFrame

MEAN_FRAMES = 5
"""Number of frames of a scene that stands still that are averaged."""
DEPTH_UNIT = 1e-4
"""Length of one step of a recorded depth image [m]."""
SETTLING = 0.4
"""Time for which the arm stands still before an image is taken [s]."""
STILL = 1e-3
"""Turn of a joint between before and after the image up to which the arm stood still [rad]."""
UNSEEN = 4
"""Number of first images after which, if none shows the board, the others would not show it, either: in the first it
is nearest to the middle."""
HOLD_SWITCH = "Release the hold-to-run switch, then hold it: the arm moves slowly to {}."
"""Prompt before every motion."""


@dataclass(frozen=True, eq=False)
class Taken:
    """One image of the board.

    Attributes:
        number: Number of the pose, from 1.
        q: Joint positions that the arm reported, (6,) [rad].
        frame: The image.
        corners: Corners of the board that were found; 0 where the board is not seen.
        X_camera_board: Pose of the board in the image, (4, 4); None where it is not seen.
    """

    number: int
    q: Array
    frame: RgbdFrame
    corners: int
    X_camera_board: Array | None


class Collector:
    """Takes the images of a calibration.

    Args:
        station: The devices.
        config: The station with the plate, from `Plate.station`.
        robot: Kinematic model of the arm with the plate.
        board: The board.
        skipped: Receives why a pose is left out, where no way leads there.
    """

    def __init__(
        self,
        station: Station,
        config: StationConfig,
        robot: RobotModel,
        board: Board,
        skipped: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._station, self._config, self._robot, self._board = station, config, robot, board
        self._skipped = skipped
        world = CollisionWorld(robot, config, robot.description.hand_open)
        self._world = world
        self.arm = Supervisor(station.arm, station.person, robot, config, lambda: world)

    def take_all(self, poses: Sequence[Array]) -> Iterator[Taken]:
        """Visit poses, one after the other, and return home.

        Args:
            poses: Joint positions, (6,) [rad] each.

        Yields:
            The images, as they are taken.

        Raises:
            PersonNearError: The hold-to-run switch was not taken, or was released.
            DeviceError: The arm was stopped, or a device does not answer.
            UserError: The first images do not show the board.
        """
        self.arm.set_payload(self._robot.description.hand_payload(self._robot.description.hand_open))
        shown: list[bool] = []
        for number, q in enumerate(poses, 1):
            if not self._move(q, f"pose {number} of {len(poses)}"):
                continue
            taken = self._take(number)
            yield taken
            shown.append(taken.X_camera_board is not None)
            if len(shown) == UNSEEN and not any(shown):
                raise UserError(
                    f"none of the first {UNSEEN} images shows the board. Look with `toolee camera show --station "
                    "FILE --picture seen.png`. Compare the camera with camera.position and camera.target: x and y "
                    "swapped, or half a turn of the base, are the usual mistakes. The print must face away from "
                    "the flange, and --sheet must be its size"
                )
        self._move(np.array(self._config.scene.home), "home")

    def _move(self, goal: Array, name: str) -> bool:
        here = self.arm.state().q_commanded
        try:
            way = plan_transfer(self._robot, self._config, self._world, here, goal)
        except PlanningError as error:
            self._skipped(f"{name} is left out: {error}")
            return False
        way = slowed_to(way, self._world, Mode.HANDOVER.speed(self._config.supervisor))
        if not self._station.person.hold_switch(HOLD_SWITCH.format(name), self._config.task.handover_timeout):
            raise PersonNearError(
                "the hold-to-run switch was not pressed anew: no motion. Release it, then hold it",
                code="person_near.switch_not_taken",
            )
        report = self.arm.execute(way)
        if report.outcome is not MotionOutcome.COMPLETED:
            raise DeviceError(f"the arm was stopped on the way to {name}")
        return True

    def _take(self, number: int) -> Taken:
        self._station.clock.sleep(SETTLING)
        before = self._station.arm.state().joints.q
        asked = self._station.clock.now()
        frame = self._station.camera.read()
        after = self._station.arm.state().joints.q
        if frame.stamp < asked:
            raise StaleDataError(
                f"the camera returned a frame {asked - frame.stamp:.2f} s older than the request. Restart the camera",
                code="stale_data.camera_repeats",
            )
        if np.abs(after - before).max() > STILL:
            raise DeviceError("the arm moved while the image was taken. It must stand still at every view")
        view = find_board(frame.rgb, self._board)
        if view is None:
            return Taken(number, (before + after) / 2, frame, 0, None)
        X = camera_board(view, self._board, frame.intrinsics)[0]
        return Taken(number, (before + after) / 2, frame, len(view.ids), X)


def save(folder: Path, taken: Taken) -> SessionPose:
    """Write the images of a pose to a session's folder.

    Args:
        folder: The folder.
        taken: The images.

    Returns:
        The pose, for the session.

    Raises:
        DeviceError: An image cannot be written.
    """
    name = f"{taken.number:03d}"
    image, depth = f"{name}.png", f"{name}_depth.png"
    metres = np.nan_to_num(taken.frame.depth, nan=0.0)
    steps = np.clip(np.round(metres / DEPTH_UNIT), 0, 65535).astype(np.uint16)
    for file, pixels in ((image, cv2.cvtColor(taken.frame.rgb, cv2.COLOR_RGB2BGR)), (depth, steps)):
        if not cv2.imwrite(str(folder / file), pixels):
            raise DeviceError(f"cannot write {folder / file}")
    return SessionPose(image, q=tuple(float(v) for v in taken.q), depth=depth)


def session_of(station: Station, poses: Sequence[SessionPose]) -> Session:
    """The session of images that were taken on a station.

    Args:
        station: The devices.
        poses: The poses.

    Returns:
        The session.
    """
    return Session(
        station.robot_serial, station.camera_serial, station.camera.intrinsics, tuple(poses), depth_unit=DEPTH_UNIT
    )


def mean_frame(camera: RgbdCamera, count: int = MEAN_FRAMES) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Average frames of a scene that stands still.

    Args:
        camera: The camera.
        count: Number of frames.

    Returns:
        Mean image, (H, W, 3) uint8, and median depth, (H, W) [m], NaN where no frame has one.

    Raises:
        DeviceError: The camera does not answer.
    """
    frames = [camera.read() for _ in range(count)]
    rgb = np.rint(np.mean([frame.rgb for frame in frames], axis=0)).astype(np.uint8)
    depths = np.stack([np.where(frame.depth > 0.0, frame.depth, np.nan) for frame in frames])
    known = np.isfinite(depths).any(axis=0)
    median = np.full(depths.shape[1:], np.nan, np.float32)
    median[known] = np.nanmedian(depths[:, known], axis=0)
    return rgb, median
