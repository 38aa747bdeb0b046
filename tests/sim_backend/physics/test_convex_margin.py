"""Where pybullet's contact with a convex mesh begins, against where its surface is."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pybullet as pb
import pytest
import trimesh

from toolee_robot.sim_backend.physics.bullet import MARGIN, shrink_convex


def distance_to_probe(parts: list[trimesh.Trimesh], height: float) -> float:
    """Distance [m] from a ball of 5 mm, `height` over the origin, to a body of these convex parts, by pybullet."""
    client = pb.connect(pb.DIRECT)
    with tempfile.TemporaryDirectory() as folder:
        collisions = ""
        for i, part in enumerate(parts):
            part.export(Path(folder) / f"{i}.obj")
            collisions += f'<collision><geometry><mesh filename="{folder}/{i}.obj"/></geometry></collision>'
        inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
        urdf = Path(folder) / "body.urdf"
        urdf.write_text(f'<robot name="b"><link name="b">{inertial}{collisions}</link></robot>')
        body = pb.loadURDF(str(urdf), physicsClientId=client)
    shape = pb.createCollisionShape(pb.GEOM_SPHERE, radius=0.005, physicsClientId=client)
    ball = pb.createMultiBody(1.0, shape, -1, [0, 0, height], physicsClientId=client)
    points = pb.getClosestPoints(ball, body, 1.0, physicsClientId=client)
    pb.disconnect(client)
    return float(min(p[8] for p in points))


def test_a_compound_body_meets_others_where_its_faces_are() -> None:
    face = trimesh.creation.cylinder(radius=0.014, height=0.06)
    other = trimesh.creation.box((0.02, 0.02, 0.02))
    other.apply_translation([0.1, 0.0, 0.0])
    height = 0.030 + 0.005 + 0.010
    assert distance_to_probe([face, other], height) == pytest.approx(0.010 - MARGIN, abs=1e-4)
    assert distance_to_probe([shrink_convex(face), shrink_convex(other)], height) == pytest.approx(0.010, abs=1e-4)


def test_shrunk_faces_lie_a_margin_deeper() -> None:
    box = trimesh.creation.box((0.02, 0.03, 0.04))
    box.apply_translation([0.5, 0.1, -0.2])
    np.testing.assert_allclose(shrink_convex(box).extents, box.extents - 2 * MARGIN, atol=1e-9)
    np.testing.assert_allclose(shrink_convex(box).centroid, box.centroid, atol=1e-9)


def test_a_part_thinner_than_the_margin_keeps_a_core() -> None:
    sheet = trimesh.creation.box((0.02, 0.03, 0.001))
    core = shrink_convex(sheet)
    assert core.is_watertight
    assert core.extents[2] == pytest.approx(0.0002, rel=0.01)
    assert np.all(core.extents[:2] < sheet.extents[:2])
