"""Systematic errors of a time-of-flight camera, which `toolee_robot.depth_noise` leaves out.

That they exist is published: wiggling with the distance and an error that depends on the reflectivity (Lachat et al.,
"Assessment and calibration of a RGB-D camera (Kinect v2)", Remote Sensing 2015; Lindner et al., "Time-of-flight sensor
calibration for accurate range sensing", CVIU 2010), light that took a longer way over polished surfaces (Fuchs,
"Multipath interference compensation in time-of-flight camera images", ICPR 2010). Their sizes here are assumed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.depth_noise import KINDS, DepthNoise, SensorKind
from toolee_robot.render.mesh import FloatArray
from toolee_robot.render.renderer import Image
from toolee_robot.render.scene import Rendering
from toolee_robot.render.sensor_models import measure_depth
from toolee_robot.render.triangulation import Registration, Surface, TriangulatingCamera, in_patches, smooth_noise
from toolee_robot.types import CameraIntrinsics

_PATCH = 0.012
"""Size of holes and of light's detours on a tool [m]."""
HELD_AT = 0.5
"""Distance of a tool that a station's camera looks at [m]."""


@dataclass(frozen=True)
class SystematicErrors:
    """What one camera does wrong in every frame.

    Attributes:
        wiggle: Amplitude of the error that swings with the distance [m].
        period: Its period [m].
        phase: Its phase [rad].
        black: Error of a black surface beside a white one [m].
        detour: Mean error of a polished surface, by light that came another way [m].
        holes: Share of polished surfaces that is lost, in patches: saturated where they mirror the light back, dark
            elsewhere.
        nearest: Smallest range [m].
    """

    wiggle: float
    period: float
    phase: float
    black: float
    detour: float
    holes: float
    nearest: float

    @staticmethod
    def random(rng: np.random.Generator) -> SystematicErrors:
        """Draw a camera.

        Args:
            rng: Random generator.

        Returns:
            Its errors.
        """
        u = rng.uniform
        return SystematicErrors(
            wiggle=u(0.0, 0.006),
            period=u(0.4, 1.2),
            phase=u(0.0, 2 * np.pi),
            black=u(-0.005, 0.01),
            detour=u(0.0, 0.015),
            holes=u(0.0, 0.7),
            nearest=u(0.3, 0.5),
        )

    def seen(
        self, surface: Surface, focal: float, rng: np.random.Generator, distance: float | None = None
    ) -> FloatArray:
        """The depth that the camera's noise acts on.

        Args:
            surface: The surfaces.
            focal: Focal length of the image [px].
            rng: Random generator of the patches, which belong to the pixels: frames of one camera take the same one,
                and the same distance.
            distance: Distance at which patches have their size [m]; None for the surfaces' median.

        Returns:
            Depth with the systematic errors, (H, W) float32 [m]; 0 where nothing is read.
        """
        depth, shine = surface.depth, surface.shininess
        known = depth > 0
        if distance is None:
            distance = max(float(np.median(depth[known])) if known.any() else 1.0, 0.1)
        size = _PATCH * focal / distance
        value = depth + np.float32(self.wiggle) * np.sin(2 * np.pi * depth / self.period + self.phase)
        value += np.float32(self.black) * (1.0 - surface.brightness) ** 4
        value += np.float32(self.detour) * shine * np.abs(smooth_noise(depth.shape, size, rng))
        lost = in_patches(self.holes * shine, size, rng) | ~known | (depth < self.nearest)
        return np.where(lost, 0.0, value).astype(np.float32)


_SINGLE = KINDS[:-1]
_SHARES = (0.3, 0.2, 0.2, 0.2, 0.1)
"""Shares of the single kinds in `mixed`."""
_BASELINES: dict[SensorKind, float] = {
    "time-of-flight-lab": 0.052,
    "structured-light": 0.025,
    "active-stereo": 0.015,
    "filled-stereo": 0.015,
}
"""Distance of the depth camera from the colour camera [m]: Kinect v2, Kinect v1, RealSense D435."""


def random_reading(
    kind: SensorKind,
    image: Image | Rendering,
    K: CameraIntrinsics,
    rng: np.random.Generator,
    device: str = "cpu",
    fields: np.random.Generator | None = None,
    noise: np.random.Generator | None = None,
) -> FloatArray:
    """Read depth with a randomly drawn sensor of a kind.

    Args:
        kind: The kind of sensor.
        image: The rendered image.
        K: Intrinsics of the camera.
        rng: Random generator of the sensor's parameters, and of all else that has none of its own. Readings of one
            sensor are given one of the same seed.
        device: "cpu" or "cuda".
        fields: Random generator of the sensor's smooth errors, which stay with the pixels: for readings of one sensor
            one of the same seed. None for `rng`.
        noise: Random generator of what differs between readings of one sensor; None for `rng`.

    Returns:
        Depth in the colour camera's pixels, (H, W) float32 [m]; 0 where there is none.
    """
    # The size of patches must not follow what is in the image where they stay.
    patches_at = None if fields is None else HELD_AT
    fields, noise = (rng if own is None else own for own in (fields, noise))
    if kind == "mixed":
        kind = _SINGLE[int(rng.choice(len(_SINGLE), p=_SHARES))]
    if kind == "time-of-flight":
        surface = (image.depth, image.cos_incidence, image.shininess)
        return measure_depth(*surface, K, DepthNoise.random(rng), noise, device)
    seen = Surface.of(image)
    if kind == "time-of-flight-lab":
        depth = SystematicErrors.random(rng).seen(seen, K.fx, fields, patches_at)
        surface = (depth, seen.cos_incidence, seen.shininess)
        reading = measure_depth(*surface, K, DepthNoise.random(rng), noise, device)
    elif kind == "structured-light":
        reading = TriangulatingCamera.structured_light(rng).measure(seen, K, noise, fields)
    else:
        camera = TriangulatingCamera.active_stereo(rng, filled=kind == "filled-stereo")
        reading = camera.measure(seen, K, noise, fields)
    return Registration.random(_BASELINES[kind], rng).apply(reading, seen.depth, K)
