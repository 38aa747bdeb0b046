"""Ray-casting renderer of the simulated camera and the synthetic data.

Embree (CPU) or Warp (GPU) intersects the rays; Warp kernels shade the hits on either device.
"""

from toolee_robot.render.material import Body, Environment, Light, Lobe, Material, Pattern, Rendering, Scene
from toolee_robot.render.mesh import Mesh
from toolee_robot.render.renderer import render
