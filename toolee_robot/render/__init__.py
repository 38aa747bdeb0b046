"""One renderer for the simulated camera and the synthetic data: rays by embree on the processor or by Warp on a GPU,
and Warp's kernels, on either, that shade what they hit."""

from toolee_robot.render.material import Material, Pattern
from toolee_robot.render.mesh import Mesh
from toolee_robot.render.renderer import render
from toolee_robot.render.scene import Body, Environment, Light, Lobe, Rendering, Scene

__all__ = ["Body", "Environment", "Light", "Lobe", "Material", "Mesh", "Pattern", "Rendering", "Scene", "render"]
