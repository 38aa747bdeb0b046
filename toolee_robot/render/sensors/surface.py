"""What a depth camera looks at: the rendered surfaces before any sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from toolee_robot.render.mesh import FloatArray
from toolee_robot.render.renderer import Image
from toolee_robot.render.scene import Rendering


@dataclass(frozen=True, eq=False)
class Surface:
    """The surfaces in a camera's pixels.

    Attributes:
        depth: True depth, (H, W) float32 [m]; 0 where there is nothing.
        cos_incidence: Cosine of the angle between ray and surface normal, (H, W) float32.
        shininess: Shininess in [0, 1], (H, W) float32.
        brightness: Linear brightness in [0, 1] as the colour camera sees it, (H, W) float32; the best guess here at
            what the surface returns of the sensor's own light.
    """

    depth: FloatArray
    cos_incidence: FloatArray
    shininess: FloatArray
    brightness: FloatArray

    @staticmethod
    def of(image: Image | Rendering) -> Surface:
        """The surfaces of a rendered image.

        Args:
            image: The image, on any device or in memory.

        Returns:
            The surfaces, in memory.
        """
        brightness = (_in_memory(image.rgb).mean(axis=2, dtype=np.float32) / np.float32(255.0)) ** np.float32(2.2)
        depth, cos_incidence, shininess = map(_in_memory, (image.depth, image.cos_incidence, image.shininess))
        return Surface(depth, cos_incidence, shininess, brightness)


def _in_memory(part: Any) -> Any:
    return part if isinstance(part, np.ndarray) else part.numpy()
