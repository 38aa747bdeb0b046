"""Readings of each kind of depth camera that a data set can be taken with."""

from __future__ import annotations

import numpy as np

from toolee_robot.depth_noise import DepthNoise
from toolee_robot.render.mesh import FloatArray
from toolee_robot.render.renderer import Image
from toolee_robot.render.scene import Rendering
from toolee_robot.render.sensors.depth_camera import measure_depth
from toolee_robot.render.sensors.lab_time_of_flight import HELD_AT, SystematicErrors
from toolee_robot.render.sensors.registration import Registration
from toolee_robot.render.sensors.surface import Surface
from toolee_robot.render.sensors.triangulation import TriangulatingCamera
from toolee_robot.sensor_kinds import KINDS, SensorKind
from toolee_robot.types import CameraIntrinsics

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
