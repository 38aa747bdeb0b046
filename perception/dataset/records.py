"""The record of one synthetic example, and how its end effectors (EE) are numbered."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from toolee_robot.robots import SHADOW_HAND
from toolee_robot.types import CameraIntrinsics, RgbdFrame

HEIGHT, WIDTH = 424, 512
"""Every image of the data set has this size [px]."""
MAX_EES = 8
"""EE ids are 1..MAX_EES."""
MIN_POINTS = 50
"""An EE with fewer visible pixels counts as not labelled: neither to be found nor a false alarm."""
NEAREST, FARTHEST = 0.4, 1.1
"""Depths [m] at which EEs are placed."""
SHOWN_HAND = SHADOW_HAND
"""The hand that holds the tools, or its mirror image; `X_camera_hand` is its frame."""
MAX_OCCLUSION = 0.7
"""An EE of which more is hidden is no target."""
INSTANCES = 150
"""Tools of each kind, by seed; every fifth is held out."""
SCENES = ("hard", "station", "empty", "paper")
"""Kinds of scenes; `Example.scene` is an index in it. Hard: anything, anywhere; station: a UR10 and a hand show a
tool; empty: no tool."""
POSES = {"m2c": "X_camera_ee", "t2c": "X_camera_tool", "h2c": "X_camera_hand"}
"""Suffix of scene_gt's cam_R_ and cam_t_ -> pose in `EeTable`: EE (BOP's model), tool, hand to camera."""

FloatArray = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class EeTable:
    """What is known of the EEs of one image (leading shape (8,)) or of N (leading shape (N, 8)); id k is row k - 1.

    category: uint8 class index, 0 where there is no EE. tool: uint8 id of its tool (1..3). obj_id: int32,
    BOP's: which EE of which tool (`instances.object_of`). X_camera_ee, X_camera_tool, X_camera_hand: (..., 4, 4)
    float32, the hand's NaN where no hand holds the tool. mirrored: bool, a left hand. visible: int32 pixels of its
    mask; unoccluded: how many there would be without anything in front.
    """

    category: NDArray[np.uint8]
    tool: NDArray[np.uint8]
    obj_id: NDArray[np.int32]
    X_camera_ee: FloatArray
    X_camera_tool: FloatArray
    X_camera_hand: FloatArray
    mirrored: NDArray[np.bool_]
    visible: NDArray[np.int32]
    unoccluded: NDArray[np.int32]

    @staticmethod
    def empty() -> EeTable:
        """A table of eight rows without any EE."""
        pose = np.full((MAX_EES, 4, 4), np.nan, np.float32)
        return EeTable(
            np.zeros(MAX_EES, np.uint8),
            np.zeros(MAX_EES, np.uint8),
            np.zeros(MAX_EES, np.int32),
            pose.copy(),
            pose.copy(),
            pose.copy(),
            np.zeros(MAX_EES, np.bool_),
            np.zeros(MAX_EES, np.int32),
            np.zeros(MAX_EES, np.int32),
        )

    @property
    def occlusion(self) -> FloatArray:
        """Share of each EE's in-image mask that something hides, in [0, 1]."""
        full = np.maximum(self.unoccluded, 1)
        return np.clip(1.0 - self.visible / full, 0.0, 1.0).astype(np.float32)

    @property
    def targets(self) -> NDArray[np.bool_]:
        """The EEs that are to be found and whose pose is asked for: at least 50 pixels seen, at most 70 % hidden, 0.4
        to 1.1 m away."""
        depth = self.X_camera_ee[..., 2, 3]
        known = (self.category > 0) & (self.visible >= MIN_POINTS) & (self.occlusion <= MAX_OCCLUSION)
        with np.errstate(invalid="ignore"):
            return known & (depth >= NEAREST) & (depth <= FARTHEST)


@dataclass(frozen=True, eq=False)
class Example:
    """rgb (H, W, 3) uint8. depth_mm (H, W) uint16, the noisy sensor's, 0 where unknown. ee (H, W) uint8: id of the EE
    whose sphere (`EndEffectorSpec.radius`) holds the tool's pixel (the nearer one where two overlap), 0 for
    none. tool (H, W) uint8: id of the tool, 0 for none. scene: index in `SCENES`. full (H, W) uint8: bit k - 1 is set
    where EE k would be seen if nothing but its tool were there."""

    rgb: NDArray[np.uint8]
    depth_mm: NDArray[np.uint16]
    ee: NDArray[np.uint8]
    tool: NDArray[np.uint8]
    table: EeTable
    intrinsics: CameraIntrinsics
    scene: int
    full: NDArray[np.uint8]

    @property
    def frame(self) -> RgbdFrame:
        """As a camera would deliver it."""
        return RgbdFrame(self.rgb, self.depth_mm.astype(np.float32) * np.float32(1e-3), self.intrinsics)
