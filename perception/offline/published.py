"""The paper's own protocol, as its public code makes clouds: `toolee evaluate table1`.

Few tools, each scaled anew in every image of 1920x1080; exact depth, no cleaning, and no image of colours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import count, islice
from typing import Any

import numpy as np
import torch
import trimesh

from toolee_robot.end_effectors import CATEGORIES
from toolee_robot.frames import inverse, transform, transform_points
from toolee_robot.perception.offline.dataset.records import CIRCLE, FOCAL, FULL_HEIGHT, FULL_WIDTH
from toolee_robot.perception.offline.evaluation import metrics, pose
from toolee_robot.perception.offline.evaluation.estimates import Estimates
from toolee_robot.perception.offline.processes import ProcessMap
from toolee_robot.perception.offline.research.tooleenet_training import paper_source
from toolee_robot.perception.offline.synthesis.bodies import HandStyle, hand_bodies
from toolee_robot.perception.offline.synthesis.example import label
from toolee_robot.perception.offline.synthesis.placement import PlacedTool, SceneSample, Stance, X_world_hand_of, look
from toolee_robot.perception.offline.synthesis.station import shown_grasp
from toolee_robot.perception.offline.synthetic_clouds.batch import CloudConfig
from toolee_robot.perception.offline.synthetic_clouds.rendered import RenderedClouds, RenderedSource, stored
from toolee_robot.perception.offline.training import pose_validation as validation
from toolee_robot.perception.pose.canonical import MIN_POINTS
from toolee_robot.perception.pose.cloud_estimator import CloudEstimator
from toolee_robot.perception.pose.tooleenet import PaperEstimator
from toolee_robot.render import Body, Material, Mesh, Scene
from toolee_robot.render.renderer import Shot, pixel_rays
from toolee_robot.tools import Handle, Tool, ToolKind, make_tool
from toolee_robot.tools.catalog import role
from toolee_robot.types import CameraIntrinsics

TOOLS: dict[ToolKind, tuple[float, int, int]] = {
    ToolKind.CLAW_HAMMER: (0.3, 8, 9),
    ToolKind.HANGING_CLAW_HAMMER: (0.3, 3, 3),
    ToolKind.SLOTTED_SCREWDRIVER: (0.2, 5, 4),
    ToolKind.PHILLIPS_SCREWDRIVER: (0.2, 5, 4),
    ToolKind.NUT_DRIVER: (0.2, 2, 2),
    ToolKind.LONG_SLOTTED_SCREWDRIVER: (0.2, 1, 1),
    ToolKind.LONG_PHILLIPS_SCREWDRIVER: (0.2, 1, 1),
    ToolKind.OPEN_END_WRENCH: (0.2, 6, 4),
    ToolKind.COMBINATION_WRENCH: (0.2, 7, 5),
    ToolKind.BOX_WRENCH: (0.2, 4, 3),
}
"""Diagonal of the box about a tool [m], number of seen tools, number of held-out ones.

The paper has 11 hammers, 14 screwdrivers and 17 wrenches, and holds out one of each. Which kinds they are is assumed.
"""
_NONE = np.empty((0, 3))
_CHUNK = 128
"""Clouds that are estimated at a time."""
_FINER = 2
"""Its images have this many times the resolution of the configuration `paper`."""
_F, _WIDE = _FINER * FOCAL, _FINER * np.array([FULL_WIDTH, FULL_HEIGHT])
_CENTRE = _WIDE / 2 - 0.5


def tools(held_out: bool) -> list[tuple[ToolKind, int, float]]:
    """Kind, seed and diagonal of the seen tools, or of the held-out ones (role "test")."""
    wanted = "test" if held_out else "train"
    return [
        (kind, seed, diagonal)
        for kind, (diagonal, *numbers) in TOOLS.items()
        for seed in islice((s for s in count() if role(s) == wanted), numbers[held_out])
    ]


def scaled(tool: Tool, factor: float) -> Tool:
    """A tool of another size.

    Args:
        tool: The tool.
        factor: Factor on its size.

    Returns:
        The tool, with surface, ends and handle scaled.
    """
    ees = tuple(replace(ee, X_tool_ee=transform(ee.X_tool_ee[:3, :3], factor * ee.X_tool_ee[:3, 3])) for ee in tool.ees)
    mesh = trimesh.Trimesh(factor * tool.mesh.vertices, tool.mesh.faces, process=False)
    handle = Handle(factor * tool.handle.z, factor * tool.handle.radii_x, factor * tool.handle.radii_y)
    return replace(tool, mesh=mesh, ees=ees, handle=handle)


def published_scene(rng: np.random.Generator, tool: Tool) -> SceneSample:
    """A scene of the published generator: an upright tool that does not turn, in a right hand, and nothing else.

    The camera looks at the middle of the tool, before it is shifted along its handle. It is 0.3 to 0.6 m beside that
    point on both horizontal axes, on either side, and 0.1 m below to 0.5 m above it.

    Args:
        rng: Random generator.
        tool: The tool, at its size in this image.

    Returns:
        The scene; its camera sees the window about the tool.
    """
    beside = rng.choice([-1.0, 1.0], 2) * rng.uniform(0.3, 0.6, 2)
    target = -np.array([*beside, rng.uniform(-0.1, 0.5)])
    X_world_camera, vertices = look(np.zeros(3), target, 0.0), np.asarray(tool.mesh.vertices)
    X_world_tool = transform(p=target - 0.5 * (vertices.min(axis=0) + vertices.max(axis=0)))
    grasp = shown_grasp(round(tool.handle.grip_radius, 4))
    X_world_hand = X_world_hand_of(X_world_tool, grasp.X_hand_tool)
    along = np.clip(rng.uniform(-0.05, 0.05), tool.handle.z_min + 0.03, max(tool.handle.z_max, 0.0))
    X_world_tool = X_world_tool @ transform(p=(0.0, 0.0, -along))  # the hand stays in view, and the tool moves

    points = transform_points(inverse(X_world_camera) @ X_world_tool, vertices)
    pixels = points[:, :2] / points[:, 2:] * _F + _CENTRE
    first = np.clip(np.floor(pixels.min(axis=0)) - 2, 0, _WIDE - 1)
    width, height = (np.clip(np.ceil(pixels.max(axis=0)) + 2, 0, _WIDE - 1) - first + 1).astype(int).tolist()
    cx, cy = (_CENTRE - first).tolist()
    window = CameraIntrinsics(_F, _F, cx, cy, width, height)
    grey = Material()
    bodies = [*hand_bodies(grasp, HandStyle(False, grey, grey, grey), X_world_hand, 101)]
    bodies.append(Body(Mesh.build(vertices, np.asarray(tool.mesh.faces)), X_world_tool, grey, 1))
    placed = PlacedTool(tool, X_world_tool, X_world_hand, False, 1, Stance.HELD)
    return SceneSample(Scene(bodies), window, X_world_camera, (placed,), 0, _FINER * CIRCLE)


def clouds_of_image(seed: tuple[int, ...], kind: ToolKind, number: int, diagonal: float, whole: bool) -> RenderedClouds:
    """The clouds of an image.

    Args:
        seed: Seed of the image.
        kind: Kind of the tool.
        number: Seed of the tool.
        diagonal: Usual diagonal of the box about it [m].
        whole: Whether to take the whole tool, once for each category of its ends.

    Returns:
        A cloud of each end with at least 50 points, camera frame.
    """
    rng = np.random.default_rng(seed)
    tool = make_tool(kind, number)
    size = float(np.linalg.norm(tool.mesh.extents))
    sample = published_scene(rng, scaled(tool, rng.uniform(0.8, 1.2) * diagonal / size))
    shot = Shot(sample.scene, sample.intrinsics, sample.X_world_camera)
    ee_ids, tool_ids, _, table = label(sample, shot)
    rays, rows = pixel_rays(sample.intrinsics), []
    for k in range(len(tool.ees)):
        mask = tool_ids == 1 if whole else ee_ids == k + 1
        seen = int(mask.sum())
        if seen < MIN_POINTS or (whole and table.category[k] in table.category[:k]):
            continue
        points = rays[mask] * shot.depth[mask][:, None]
        about = table.X_camera_ee[k], table.X_camera_tool[k], float(table.occlusion[k])
        row = stored((points, _NONE, _NONE), CATEGORIES.index(tool.ees[k].category), *about, rng)
        rows.append(replace(row, of_tool=np.array([whole])))
    return RenderedClouds.cat(rows)


def published_clouds(
    images: int,
    seed: int,
    held_out: bool = False,
    whole_tools: bool = False,
    workers: int = 1,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> RenderedClouds:
    """The clouds of the protocol.

    Args:
        images: Images of each tool.
        seed: Seed of the images.
        held_out: Whether to show the held-out tools.
        whole_tools: Whether to take whole tools.
        workers: Number of processes.
        progress: Called with the finished number of images of each tool, and `images`.

    Returns:
        The clouds: those of the first image of each tool, then those of the second, and so on.
    """
    found = []
    with ProcessMap(partial(tools, held_out), workers) as processes:
        for clouds in processes.map(partial(_of_tools, seed, held_out, whole_tools), range(images)):
            found.append(clouds)
            progress(len(found), images)
    return RenderedClouds.cat(found)


def _of_tools(
    seed: int, held_out: bool, whole: bool, shown: list[tuple[ToolKind, int, float]], image: int
) -> RenderedClouds:
    return RenderedClouds.cat([clouds_of_image((seed, held_out, k, image), *t, whole) for k, t in enumerate(shown)])


def table(
    estimator: CloudEstimator, images: int, seed: int, workers: int, progress: Callable[[str, int, int], None]
) -> dict[str, Any]:
    """Judge an estimator on new images of held-out and of seen tools.

    Args:
        estimator: The estimator of a column, or this project's own.
        images: Images of each tool.
        seed: Seed of the images, and of the sampling.
        workers: Number of processes that render.
        progress: Called with the name of the stage, the finished number and the total.

    Returns:
        See `pose.tables`.

    Raises:
        PerceptionError: RK45 does not solve the network's field.
    """
    groups: dict[str, Any] = {}
    for group, held_out in zip(pose.GROUPS, (True, False), strict=True):
        rendered, rows = partial(progress, f"{group}: images of each tool"), []
        clouds = published_clouds(images, seed, held_out, estimator.of_tool, workers, rendered)
        if isinstance(estimator, PaperEstimator):
            source = paper_source(clouds, estimator.column, "cpu", seed)
        else:
            source = RenderedSource(clouds, "cpu", seed, CloudConfig(negative_share=0.0))
        for some in torch.split(torch.arange(len(clouds)), _CHUNK):
            found = validation.evaluate(estimator, source.rows(some), estimator.candidates, seed + int(some[0]))
            for k, (result, X) in enumerate(zip(found.results, found.Xs_true, strict=True)):
                by_paper = metrics.paper_rule_angle(result.X_camera_ee[:3, :3], X[:3, :3], result.ambiguous)
                rows.append((found.category[k], found.angle[k], found.position[k], by_paper))
            progress(f"{group}: clouds", len(rows), len(clouds))
        category, angle, position, paper = (np.array(column) for column in zip(*rows, strict=True))
        no, nan = np.zeros(len(rows), bool), np.full(len(rows), np.nan)
        errors = angle, position, paper, nan, nan, nan, 0 * angle
        groups |= pose.tables(Estimates(category, no | held_out, *errors, no, nan))
    return groups
