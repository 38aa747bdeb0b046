"""The rehearsed cell: the emulated hand's fingers, the person, and the board that is held."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from typing import Any, Protocol, Self

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.calibration.board import Board, Sheet
from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array, transform
from toolee_robot.hal import Clock, Person
from toolee_robot.robots import PALM
from toolee_robot.sim_backend.devices.hand import Touched
from toolee_robot.sim_backend.devices.software_realsense import Pictures
from toolee_robot.sim_backend.hands.kit import HandEmulator
from toolee_robot.sim_backend.options import PlacedBoard
from toolee_robot.sim_backend.remote import Caller
from toolee_robot.sim_backend.visuals import BoardVisuals, VisualBody
from toolee_robot.station import CameraConfig, PersonConfig
from toolee_robot.stations.rehearsal.camera import ColorAndDepth, EmulatedLens
from toolee_robot.stations.simulated import PRINT_SCALE, RULE

PERIOD = 0.02
"""Time between two steps of the fingers on the wall clock [s]."""
STANDS = 0.005
"""Way of every joint in STANDS_FOR steps up to which the hand stands [rad]."""
STANDS_FOR = 8
OPENS = 0.08
"""Mean way of the joints towards the open hand, from where they gripped, after which the hand has let go [rad]."""
GRIP_TIME = 1.0
"""Time for the assisted grip to begin [s]."""


class FingerCoupling:
    """Couples an emulated hand with the simulated fingers, in a thread of its own while in its `with` block.

    The driver at the other end of the emulated hand's wire knows nothing of it.

    Args:
        world: Sends requests to the world.
        emulator: The emulated hand.
        q_open: Positions of the joints of the open hand [rad].
        opposing: The finger that opposes the others, without which there is no grip.
    """

    def __init__(self, world: Caller, emulator: HandEmulator[Any], q_open: Array, opposing: str) -> None:
        self._world, self._emulator, self._q_open, self._opposing = world, emulator, q_open, opposing
        self._over = threading.Event()
        self._recent: deque[Array] = deque(maxlen=STANDS_FOR)
        self._met: set[str] = set()
        self._gripped_at: float | None = None
        self._refused = False
        self._thread = threading.Thread(target=self._run, name="emulated fingers", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        with suppress(DeviceError):  # the world has ended, which every other device says
            self._couple()

    def _couple(self) -> None:
        while not self._over.wait(PERIOD):
            q = self._emulator.joints(np.array(self._emulator.angles))
            self._recent.append(q)
            touched: Touched = self._world.call("fingers.follow", q)
            if self._gripped_at is None:
                self._feel(touched, q)
            elif not touched.gripped:  # dropped, or torn out of the hand
                self._lose()
            elif self._closed(q) < self._gripped_at - OPENS:
                self._world.call("fingers.let_go")
                self._lose()

    def _feel(self, touched: Touched, q: Array) -> None:
        for finger in touched.fingers:
            self._emulator.met(finger)
            self._met.add(finger)
        if not self._stands:
            self._refused = False
        elif not self._refused and self._opposed:
            if self._world.call("fingers.grip", lasting=GRIP_TIME):
                self._gripped_at = self._closed(q)
            else:
                self._refused = True
                self._lose()

    @property
    def _opposed(self) -> bool:
        """Whether thumb and fingers have met something: fingers that wait for the thumb stand as well."""
        return self._opposing in self._met and bool(self._met - {self._opposing, PALM})

    @property
    def _stands(self) -> bool:
        return len(self._recent) == STANDS_FOR and bool(np.ptp(self._recent, axis=0).max() < STANDS)

    def _closed(self, q: Array) -> float:
        return float(np.mean(np.abs(q - self._q_open)))

    def _lose(self) -> None:
        self._gripped_at = None
        self._met.clear()
        self._emulator.hold(None)


HOLD = 0.25
"""Time for which a person holds or releases the switch for a confirmation [s]."""


class Wiring(Protocol):
    """What is wired to the robot."""

    def fault(self, name: str, /, **arguments: object) -> object:
        """Act as `digital_input` does, or `door`, which is on the safeguard as well."""


class RehearsedPerson:
    """A `hal.Person` that acts at once; its answers are those of the driver of the inputs.

    The door is on the robot's safeguard input, too, as it has to be: the robot is stopped while it is open, and made
    ready when it is closed.

    Args:
        driver: The driver, which reads the inputs.
        config: Numbers of the inputs.
        wiring: What door and switch are wired to.
        world: Sends requests to the world.
        clock: The station's clock.
        clamps: Whether the person fixes the tool in a mount, and takes it out of it.
    """

    def __init__(
        self, driver: Person, config: PersonConfig, wiring: Wiring, world: Caller, clock: Clock, *, clamps: bool
    ) -> None:
        self._driver, self._config, self._wiring = driver, config, wiring
        self._world, self._clock, self._clamps = world, clock, clamps
        self.zone_occupied: Callable[[], bool] = driver.zone_occupied
        self.hold_to_run_held: Callable[[], bool] = driver.hold_to_run_held
        self.readings_certain: Callable[[], bool] = driver.readings_certain
        self._door(closed=True)
        self._switch(held=False)

    def request_handover(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""

        def act() -> None:
            self._switch(held=False)
            self._door(closed=False)
            if self._world.call("person.request_handover", prompt, timeout, lasting=timeout):
                if self._clamps:
                    self._world.call("hand.close", timeout, lasting=timeout)
                self._press()

        return self._while(act, lambda: self._driver.request_handover(prompt, timeout))

    def release(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""

        def act() -> None:
            self._switch(held=False)
            if self._world.call("person.release", prompt, timeout, lasting=timeout):
                self._door(closed=True)
                self._clock.sleep(HOLD)
                self._press()

        return self._while(act, lambda: self._driver.release(prompt, timeout))

    def take_tool(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""

        def act() -> None:
            self._door(closed=False)
            if self._world.call("person.take_tool", prompt, timeout, lasting=timeout):
                if self._clamps:
                    self._world.call("hand.open", timeout, lasting=timeout)
                self._press()

        return self._while(act, lambda: self._driver.take_tool(prompt, timeout))

    def confirm_swing(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""
        return self._while(self._press, lambda: self._driver.confirm_swing(prompt, timeout))

    def confirm_inspection(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""
        return self._while(self._press, lambda: self._driver.confirm_inspection(prompt, timeout))

    def hold_switch(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""

        def act() -> None:
            self._switch(held=False)
            self._clock.sleep(HOLD)
            self._switch(held=True)

        return self._while(act, lambda: self._driver.hold_switch(prompt, timeout))

    def _while(self, act: Callable[[], None], ask: Callable[[], bool]) -> bool:
        with ThreadPoolExecutor(1) as pool:
            acting = pool.submit(act)
            answer = ask()
            acting.result()
        return answer

    def _press(self) -> None:
        for held in (False, True, False):
            self._switch(held=held)
            self._clock.sleep(HOLD)

    def _door(self, *, closed: bool) -> None:
        self._wiring.fault("door", opened=not closed, index=self._config.door_closed_input)
        if self._config.door_open_input is not None:
            self._input(self._config.door_open_input, not closed)

    def _switch(self, *, held: bool) -> None:
        self._input(self._config.hold_to_run_input, held)
        if self._config.hold_to_run_released_input is not None:
            self._input(self._config.hold_to_run_released_input, not held)

    def _input(self, index: int, high: bool) -> None:
        self._wiring.fault("digital_input", index=index, high=high)


FOCAL, CENTER = 0.004, 3.0
"""Largest error of the told focal lengths, relative, and of the principal point [px]."""
DISPLACEMENT = (4.0, 8.0)
"""Displacement of a pixel in the image's corner by the drawn lens [px]."""
TANGENTIAL = 3e-4
"""Largest tangential coefficient of the drawn lens."""
FINER = 2
"""Rendered pixels for each pixel along each edge: a print's edges are smooth."""
HELD = 8
"""Pictures for which the board is held still."""
TILT = float(np.deg2rad(45.0))
"""Largest tilt of the board."""
WIDTH = (0.35, 0.6)
"""Width of the board in the image, as a share of its width."""


def drawn_camera(camera: CameraConfig, rng: np.random.Generator) -> CameraConfig:
    """Draw the camera as it is.

    Args:
        camera: The camera as it tells itself.
        rng: Source of what is drawn.

    Returns:
        The camera with its true intrinsics and distortion.
    """
    fx, fy = (float(f * (1.0 + rng.uniform(-FOCAL, FOCAL))) for f in (camera.fx, camera.fy))
    cx, cy = (float(c + rng.uniform(-CENTER, CENTER)) for c in (camera.cx, camera.cy))
    corner = np.hypot(0.5 * camera.width / fx, 0.5 * camera.height / fy)
    k1 = float(rng.choice([-1.0, 1.0]) * rng.uniform(*DISPLACEMENT) / (fx * corner**3))
    p1, p2 = (float(p) for p in rng.uniform(-TANGENTIAL, TANGENTIAL, 2))
    return replace(camera, fx=fx, fy=fy, cx=cx, cy=cy, distortion=(k1, 0.0, p1, p2))


class HeldBoard:
    """What a camera sees before which somebody holds a printed board, in one way after the other.

    Args:
        camera: The camera as it is, with its distortion.
        sheet: The sheet that was printed.
        seed: Seed of the print, the poses, the room and the noise.
        clock: The station's clock.

    Attributes:
        board: The board as it is.
        bars: Lengths of its scale bars as a person has measured them [m].
        table_height: Height of the table's top over the base plane [m].
    """

    table_height = 0.0

    def __init__(self, camera: CameraConfig, sheet: Sheet, seed: int, clock: Clock) -> None:
        self._rng = np.random.default_rng([seed, 40])
        self.board = replace(sheet.board, square=sheet.board.square * self._rng.uniform(*PRINT_SCALE))
        x, y = (float(length + self._rng.normal(0.0, RULE)) for length in self.board.size)
        self.bars = (x, y)
        self._camera, self._seed, self._clock = camera, seed, clock
        self._shown = 0

    def seen_from(self, X_color_depth: Array) -> Callable[[], Pictures | None]:
        """Begin to hold it.

        Args:
            X_color_depth: Pose of the depth camera in the colour camera, (4, 4) [m].

        Returns:
            What colour and depth camera see.
        """
        lens = EmulatedLens(self._camera, FINER)
        cameras = ColorAndDepth(self, self._camera, lens, X_color_depth, self._clock, self._seed, self._rng)
        return lambda: self._pictures(cameras)

    def visual_bodies(self) -> Sequence[VisualBody]:
        """The board."""
        return list(self._held.bodies(np.eye(4)))

    def _pictures(self, cameras: ColorAndDepth) -> Pictures:
        if self._shown % HELD == 0:
            X_camera_board = held_pose(self.board, self._camera, self._rng)
            placed = PlacedBoard(self.board, self._camera.X_base_camera @ X_camera_board, on_flange=False)
            self._held = BoardVisuals(placed)
            cameras.look()
        self._shown += 1
        return cameras.take()


def held_pose(board: Board, camera: CameraConfig, rng: np.random.Generator) -> Array:
    """Draw how somebody holds a board before a camera.

    Args:
        board: The board.
        camera: The camera.
        rng: Source of what is drawn.

    Returns:
        X_camera_board, (4, 4) [m].
    """
    depth = board.size[0] * camera.fx / (rng.uniform(*WIDTH) * camera.width)
    pixel = rng.uniform(0.12, 0.88, 2) * (camera.width, camera.height)
    direction = rng.uniform(0.0, 2.0 * np.pi)
    R = Rotation.from_rotvec(rng.uniform(0.3, 1.0) * TILT * np.array([np.cos(direction), np.sin(direction), 0.0]))
    R *= Rotation.from_rotvec([0.0, 0.0, rng.uniform(-0.6, 0.6)])
    return transform(R, depth * camera.intrinsics.rays(pixel) - R.as_matrix() @ board.center)
