"""The simulated RGB-D camera: renders the world in a laboratory and applies the sensor model."""

from __future__ import annotations

import zlib
from typing import Self

import numpy as np

from toolee_robot.depth_noise import DepthNoise, SensorKind
from toolee_robot.errors import DeviceError, NoAnswerError, StaleDataError
from toolee_robot.hal import Clock
from toolee_robot.render.depth_sensors import Photo, measure_depth, photograph, random_reading
from toolee_robot.render.lab import laboratory
from toolee_robot.render.material import Body, Material, Rendering, Scene, finish
from toolee_robot.render.mesh import FloatArray
from toolee_robot.render.renderer import render
from toolee_robot.sim_backend.visuals import VisualBody, VisualWorld
from toolee_robot.station import CameraConfig
from toolee_robot.types import CameraIntrinsics, RgbdFrame

_ROOM_ID = 0
PERIOD = 1 / 30  # [s] of simulated time between two frames


class SimCamera:
    """A `hal.RgbdCamera` on a simulated world.

    A second `read` within one frame period sleeps on the station's clock until the next frame. The same seed and calls
    give the same frames. Faults can be injected with `freeze`, `repeat`, `unplug` and `blinded`; `thaw` undoes
    them.

    Args:
        world: What the camera sees.
        clock: The station's clock.
        config: Intrinsics and pose of the camera.
        seed: Seed of the room, the surface patterns and the noise.
        sensor: Kind of depth camera, which the seed draws; None for the nominal time-of-flight camera.

    Attributes:
        blinded: Fault: whether no pixel has a depth.
    """

    def __init__(
        self, world: VisualWorld, clock: Clock, config: CameraConfig, seed: int = 0, sensor: SensorKind | None = None
    ) -> None:
        self._world, self._clock, self._config = world, clock, config
        self._noise, self._photo = DepthNoise(), Photo()
        self._seed, self._sensor = seed, sensor
        self._room = laboratory(np.random.default_rng([seed, 1]), _ROOM_ID).raised(world.table_height)
        self._rng = np.random.default_rng([seed, 2])
        self._materials: dict[str, Material] = {}
        self._last: RgbdFrame | None = None
        self._open = True
        self._frozen, self._repeats, self._unplugged, self.blinded = False, False, False, False

    def __enter__(self) -> Self:
        self._open = True
        return self

    def __exit__(self, *_: object) -> None:
        self._open = False

    @property
    def intrinsics(self) -> CameraIntrinsics:
        """Intrinsics of both images."""
        return self._config.intrinsics

    def freeze(self) -> None:
        """Fault: no new frames, as with an unplugged cable."""
        self._frozen = True

    def repeat(self) -> None:
        """Fault: `read` returns the last frame again and again, as a driver that has lost its camera."""
        self._repeats = True

    def unplug(self) -> None:
        """Fault: the cable is out, and the driver has noticed it."""
        self._unplugged = True

    def thaw(self) -> None:
        """Undo `freeze`, `repeat`, `unplug` and `blinded`."""
        self._frozen, self._repeats, self._unplugged, self.blinded = False, False, False, False

    def read(self, max_age: float = 0.5) -> RgbdFrame:
        """Take a frame.

        Args:
            max_age: Longest wait for a new frame [s].

        Returns:
            A frame exposed now.

        Raises:
            StaleDataError: There is no new frame.
            NoAnswerError: The camera is unplugged.
            DeviceError: The camera is closed.
        """
        if self._unplugged:
            message = "the camera is unplugged: plug it in, and open it again"
            raise NoAnswerError(message, code="no_answer.camera_unplugged")
        if not self._open:
            raise DeviceError("the camera is closed: read inside its `with` block", code="device.closed")
        if self._frozen:
            self._clock.sleep(max_age)
            newest = "none at all" if self._last is None else f"{self._clock.now() - self._last.stamp:.2f} s old"
            raise StaleDataError(
                f"the camera gave no new frame within {max_age:.2f} s (newest: {newest}); check its cable and driver",
                code="stale_data.camera",
            )
        if self._repeats and self._last is not None:
            return self._last
        now = self._clock.now()
        if self._last is not None and now < self._last.stamp + PERIOD:
            self._clock.sleep(self._last.stamp + PERIOD - now)
            now = max(self._clock.now(), np.nextafter(self._last.stamp, np.inf))
        rendering = self.render()
        depth = self._depth(rendering)
        if self.blinded:
            depth = np.zeros_like(depth)
        frame = RgbdFrame(photograph(rendering.rgb, self._photo, self._rng), depth, self.intrinsics, float(now))
        self._last = frame
        return frame

    def _depth(self, rendering: Rendering) -> FloatArray:
        """What the depth camera reads, (H, W) [m]."""
        if self._sensor is not None:
            # Anew for each frame: the same camera, with the same errors in the same pixels.
            camera, fields = (np.random.default_rng([self._seed, stream]) for stream in (4, 5))
            return random_reading(self._sensor, rendering, self.intrinsics, camera, fields=fields, noise=self._rng)
        return measure_depth(
            rendering.depth, rendering.cos_incidence, rendering.shininess, self.intrinsics, self._noise, self._rng
        )

    def render(self) -> Rendering:
        """Render the current world without sensor noise, with the world's body ids; ground truth."""
        bodies = [*self._room.bodies, *(self._body(v) for v in self._world.visual_bodies())]
        scene = Scene(bodies, self._room.lights, self._room.environment)
        return render(scene, self.intrinsics, self._config.X_base_camera, auto_exposure=0.7)

    def _body(self, visual: VisualBody) -> Body:
        material = self._materials.get(visual.name)
        if material is None:
            rng = np.random.default_rng([self._seed, 3, zlib.crc32(visual.name.encode())])
            material = finish(
                visual.finish, visual.color, visual.roughness, visual.metallic, rng, axis=visual.grain_axis
            )
            self._materials[visual.name] = material
        return Body(visual.mesh, visual.X_base_body, material, visual.body_id)
