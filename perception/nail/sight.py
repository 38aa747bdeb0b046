"""A nail by a camera that does not move: how it leans, and how far its head has been pushed off its axis.

The camera's calibration may be off by more than what is looked for. So the first images, of the nail as it was set,
tell where foot and head appear, and the later ones where the head appears since then: what the calibration displaces,
it displaces in all of them. A head along whose line of sight nothing shows moves with the height that is known of it.

    sight = NailSight(X_base_camera, foot, diameter, head_diameter)
    lean = sight.first(frames, 0.020)      # None: it is not seen
    ...                                    # it is driven
    moved = sight.again(frames, 0.008, 0.0003)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from toolee_robot.frames import Array, inverse, transform_points
from toolee_robot.perception.nail.appearance import Appearance, NailPose
from toolee_robot.perception.nail.fit import ACROSS, View, fit_as_set
from toolee_robot.types import RgbdFrame

SEARCH, STEP = 0.018, 0.0012
"""How far from where it is believed a nail is looked for on the wood, and in which steps [m]: three deviations of a
camera that is 2 mm and 0.3 deg off at a metre."""
BLURS = (0.3, 0.5, 0.8, 1.3)
"""Blurs of cameras that are tried [pixel]; the one that explains the first image best is this camera's."""
MARGIN, WIDE = 3.0, 4.0
"""What is compared around foot and head where the nail is looked for, and where its pose is fitted [pixel]."""
EXPLAINED = 0.4
"""Least share of the variance around a nail that is the nail."""
ASIDE = (0.003, 0.006)
"""Distances from the axis at which a head is looked for that is not on it [m]."""
BETTER = 0.85
"""A head aside of its axis has to leave less than this share of what one on it leaves unexplained."""
NEARER, SPECKS = 0.06, 0.05
"""What is nearer to the camera than the nail by so much hides it [m], if it is more than this share of the pixels."""
SEEN_PART = 0.3
"""Least share of the pixels around a nail whose depth is known: else nothing tells that it is not hidden. Also the
least share that has to show wood."""
SURE, LEAST = 3.0, 3e-4
"""Within so many standard deviations every displacement that may be has to be longer than this [m]. Chosen on other
labs than those whose figures `toolee bench-bent-nails` tells."""
ANGLES = np.linspace(0.0, 2.0 * np.pi, 73)[:-1]
"""Angles at which the rim of a covariance's ellipse is sampled [rad]."""
BEHIND, EDGE = 0.025, 1
"""What lies so much farther than the wood, along the optical axis, is not wood [m], nor what is within so many pixels
of it."""


@dataclass(frozen=True, eq=False)
class HeadOffset:
    """Where a nail's head is, from where it should be.

    Attributes:
        offset: Displacement in the plane of the wood, x and y of `base`, (2,) [m].
        covariance: Its covariance, (2, 2) [m^2].
    """

    offset: Array
    covariance: Array

    @property
    def distance(self) -> float:
        """Length of the displacement [m]."""
        return float(np.hypot(*self.offset))

    @property
    def sigma(self) -> float:
        """Standard deviation along the displacement's own direction [m]."""
        along = self.offset / max(self.distance, 1e-9)
        return float(np.sqrt(along @ self.covariance @ along))

    @property
    def least(self) -> float:
        """Shortest displacement within `SURE` standard deviations [m]; 0 where none at all may be."""
        if self.offset @ np.linalg.solve(self.covariance, self.offset) <= SURE**2:
            return 0.0
        rim = SURE * np.linalg.cholesky(self.covariance) @ np.stack([np.cos(ANGLES), np.sin(ANGLES)])
        return float(np.min(np.linalg.norm(self.offset[:, None] + rim, axis=0)))

    def surely_beyond(self, limit: float) -> bool:
        """Whether the head is farther off than a limit, and by more than chance.

        A head may be far off along the line of sight, uncertain as that is, and surely off by a little across it only.

        Args:
            limit: The limit [m].

        Returns:
            Whether it is farther, and surely by more than `LEAST`.
        """
        return self.distance > limit and self.least > LEAST


class NailSight:
    """One nail, as a camera sees it.

    Args:
        X_base_camera: Pose of the camera in `base`, (4, 4).
        foot: Where the nail's axis is believed to enter the wood, `base`, (3,) [m].
        diameter: Diameter of its shank [m].
        head_diameter: Diameter of its head [m].
        axis: Its axis out of the wood, `base`, (3,); None for z.
    """

    def __init__(
        self, X_base_camera: Array, foot: Array, diameter: float, head_diameter: float, axis: Array | None = None
    ) -> None:
        self._X_camera_base = inverse(X_base_camera)
        self._camera = X_base_camera[:3, 3]
        self._believed, self._radii = foot, (0.5 * diameter, 0.5 * head_diameter)
        self._axis = np.array([0.0, 0.0, 1.0]) if axis is None else axis / axis[2]
        self._blur = BLURS[0]
        self._set: NailPose | None = None  # as it was set: as seen, and as nails are set
        self._covariance = np.zeros((4, 4))  # of its foot and head, x and y
        self._colours: Array | None = None
        self._behind: NDArray[np.float64] | None = None  # the image without it

    def first(self, frames: Sequence[RgbdFrame], height: float) -> HeadOffset | None:
        """See the nail as it was set.

        Args:
            frames: Images of it.
            height: Height of its head over the wood [m].

        Returns:
            How far its head is from its axis as believed, through its foot; None where it is hidden, outside of the
            image or not found.
        """
        seen = self._in_sight(frames, self._standing(self._believed, height))
        if not seen:
            return None
        image, wood = _mean(seen), self._wood(seen)
        found = self._find(frames[0], image, wood, height)
        window = None if found is None else self._look(frames[0], BLURS[0]).window(found, WIDE)
        if found is None or window is None:
            return None
        part, counted = window.cut(image), window.cut(wood)
        slope = float(self._axis[0]), float(self._axis[1])
        views = {blur: View(self._look(frames[0], blur), window, part, counted, slope=slope) for blur in BLURS}
        fits = {blur: view.fit(found) for blur, view in views.items()}
        self._blur = min(fits, key=lambda blur: fits[blur].misfit)
        view = views[self._blur]
        fit = fit_as_set(view, found, fits[self._blur])
        if fit.comparison.explained < EXPLAINED:
            return None
        self._set, self._covariance, self._colours = fit.pose, fit.covariance, fit.comparison.colours
        self._behind = view.look.without(image, fit.pose, self._colours)
        off = fit.pose.head - fit.pose.foot - height * self._axis
        return HeadOffset(off[:2], ACROSS @ fit.covariance @ ACROSS.T)

    def again(self, frames: Sequence[RgbdFrame], height: float, sigma: float) -> HeadOffset | None:
        """See where the head is after strikes.

        Args:
            frames: Images of the nail.
            height: Height of its head over the wood [m].
            sigma: Standard deviation of that height [m].

        Returns:
            How far the head is from the axis on which it was set; None where the nail was not or is not seen.
        """
        if self._set is None or self._behind is None:
            return None
        foot, head = self._set.foot, self._set.head
        share = height / (head - foot)[2]
        expected = NailPose(foot, foot + share * (head - foot))
        seen = self._in_sight(frames, expected)
        if not seen or seen[0].rgb.shape != self._behind.shape:
            return None
        added = _mean(seen) - self._behind
        look = self._look(frames[0], self._blur)
        starts = [(start, look.window(start, WIDE)) for start in self._starts(expected)]
        fits = [
            View(look, window, window.cut(added), colours=self._colours).fit(start)
            for start, window in starts
            if window is not None
        ]
        # The first is the expected one: its window is in the image, or nothing would have been in sight.
        on_axis, best = fits[0], min(fits, key=lambda fit: fit.comparison.left)
        fit = best if best.comparison.left < BETTER * on_axis.comparison.left else on_axis
        axis = np.hstack([(1.0 - share) * np.eye(2), share * np.eye(2)])
        ray = expected.head - self._camera
        along = ray[:2] / ray[2]  # a head that is higher than believed looks as if it were nearer to the camera
        total = fit.covariance[2:, 2:] + axis @ self._covariance @ axis.T + sigma**2 * np.outer(along, along)
        return HeadOffset((fit.pose.head - expected.head)[:2], total)

    def _standing(self, foot: Array, height: float) -> NailPose:
        return NailPose(foot, foot + height * self._axis)

    def _look(self, frame: RgbdFrame, blur: float) -> Appearance:
        return Appearance(frame.intrinsics, self._X_camera_base, *self._radii, blur)

    def _in_sight(self, frames: Sequence[RgbdFrame], pose: NailPose) -> Sequence[RgbdFrame]:
        """Those frames in which a nail's window is in the image and nothing hides it."""
        return [frame for frame in frames if self._is_in_sight(frame, pose)]

    def _is_in_sight(self, frame: RgbdFrame, pose: NailPose) -> bool:
        look = self._look(frame, BLURS[0])
        window = look.window(pose, WIDE)
        if window is None:
            return False
        depth = window.cut(frame.depth)
        known = depth[depth > 0.0]  # NaN is not
        if known.size < SEEN_PART * depth.size:
            return False
        return bool(np.quantile(known, SPECKS) > look.depth(pose.head) - NEARER)

    def _wood(self, frames: Sequence[RgbdFrame]) -> NDArray[np.bool_]:
        """Which pixels show the wood, or what stands on it: the edge of a block looks much like a nail."""
        K, up = frames[0].intrinsics, self._X_camera_base[:3, 2]
        distance = up @ transform_points(self._X_camera_base, self._believed[None])[0]
        depths = np.stack([frame.depth for frame in frames])
        rows, columns = np.indices(depths.shape[1:])
        wood = distance / (K.rays(np.stack([columns, rows], axis=-1)) @ up)
        # In most of the frames that know their depth; what is unknown, 0 or NaN, is neither.
        behind = 2 * np.sum(depths > wood + BEHIND, axis=0) > np.sum(depths > 0.0, axis=0)
        return cv2.dilate(behind.astype(np.uint8), np.ones((2 * EDGE + 1, 2 * EDGE + 1), np.uint8)) == 0

    def _find(
        self, frame: RgbdFrame, image: NDArray[np.float64], wood: NDArray[np.bool_], height: float
    ) -> NailPose | None:
        """Look for a nail that stands as believed around the place where it is believed."""
        look, best = self._look(frame, BLURS[len(BLURS) // 2]), None
        steps = np.arange(-SEARCH, SEARCH + 0.5 * STEP, STEP)
        for x in steps:
            for y in steps[np.hypot(x, steps) <= SEARCH]:
                pose = self._standing(self._believed + np.array([x, y, 0.0]), height)
                window = look.window(pose, MARGIN)
                if window is None or np.mean(window.cut(wood)) < SEEN_PART:
                    continue
                compared = look.compare(window.cut(image), window, pose, window.cut(wood))
                gain = float(np.sum(compared.without**2) - np.sum(compared.residuals**2))
                if best is None or gain > best[0]:
                    best = gain, pose
        return None if best is None else best[1]

    def _starts(self, expected: NailPose) -> list[NailPose]:
        """The expected pose, and some with the head off the axis."""
        angles = np.arange(0.0, 2.0 * np.pi, np.pi / 4)
        aside = [radius * np.array([np.cos(a), np.sin(a), 0.0]) for radius in ASIDE for a in angles]
        return [expected, *(NailPose(expected.foot, expected.head + offset) for offset in aside)]


def _mean(frames: Sequence[RgbdFrame]) -> NDArray[np.float64]:
    """The mean of their colour images, (H, W, 3)."""
    return np.asarray(np.mean([frame.rgb for frame in frames], axis=0))
