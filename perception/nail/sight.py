"""A nail by a camera that does not move: how it leans, and how far its head has been pushed off its axis.

The camera's calibration may be off by more than what is looked for. So the first images, of the nail as it was set,
tell where foot and head appear, and the later ones where the head appears since then: what the calibration displaces,
it displaces in all of them. A head along whose line of sight nothing shows moves with the height that is known of it.
`fit` is the first look, by least squares; `change` and `moved` are the later ones.

    sight = NailSight(X_base_camera, foot, diameter, head_diameter)
    lean = sight.first(frames, 0.020)      # None: it is not seen
    ...                                    # it is driven
    moved = sight.again(frames, 0.008, 0.0003)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from toolee_robot.frames import Array, inverse, transform_points
from toolee_robot.perception.nail.appearance import Appearance, Comparison, NailPose, Window
from toolee_robot.perception.nail.change import REACH, AsSet, Change, fit_moved
from toolee_robot.types import RgbdFrame

SPREAD = 3.0
"""Errors as a multiple of what independent pixels would leave: wood has a grain. By `benchmarks/bent_nails.py`."""
FAINT = 0.03
"""Least that is left of a mixture of channels, as a share of what is left of a channel."""
LEAN = np.deg2rad(3.0)
"""Standard deviation of the lean, to each side, of a nail that a person has set upright: assumed. The lean that the
first image tells along the line of sight is 4 degrees off as a rule, and more now and then."""
OVERRULED = 3.0
"""The usual lean is overruled where its best fit leaves so many standard deviations more than the best fit of any lean.
Of 120 simulated nails with the usual lean the worst leaves 2.5; of 120 that lean by 12 to 25 degrees 107 leave 3 or
more."""
ACROSS = np.hstack([-np.eye(2), np.eye(2)])
"""From foot and head, x and y, to the head's displacement from the foot, (2, 4)."""
DIFFERENCE = 2.5e-4
"""Step of the derivatives [m]: a tenth of a pixel or more."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A pose of a nail that was fitted to a part of an image.

    Attributes:
        pose: The pose.
        covariance: Covariance of foot and head, x and y, (4, 4) [m^2].
        comparison: How the image compares with it.
        misfit: Sum of squares that it leaves, that of an unusual lean included, in units of the image, squared.
    """

    pose: NailPose
    covariance: Array
    comparison: Comparison
    misfit: float


@dataclass(frozen=True, eq=False)
class View:
    """A part of an image to which poses of a nail are fitted.

    Attributes:
        look: What a nail looks like.
        window: The part.
        image: The part of the image, (h, w, n), in channels of brightness or mixtures of them.
        wood: Which of its pixels count, (h, w); None for all.
        slope: How the nail is believed to lean, x and y of `base` per z, from which a lean is weighed.
    """

    look: Appearance
    window: Window
    image: NDArray[np.float64]
    wood: NDArray[np.bool_] | None = None
    slope: tuple[float, float] = (0.0, 0.0)

    def compare(self, pose: NailPose) -> Comparison:
        """How the part compares with a nail."""
        return self.look.compare(self.image, self.window, pose, self.wood)

    def fit(self, start: NailPose, noise: float | None = None) -> Fit:
        """Fit the places of foot and head.

        Args:
            start: Where the fit begins; its heights stay.
            noise: Noise of a pixel, `SPREAD` included, in units of the image, against which a lean is weighed that
                nails do not have as a rule; None where every lean is as good.

        Returns:
            The fit.
        """
        height = (start.head - start.foot)[2]
        usual, believed = LEAN * height, height * np.asarray(self.slope)

        def pose(x: Array) -> NailPose:
            return NailPose(start.foot + np.array([*x[:2], 0.0]), start.head + np.array([*x[2:], 0.0]))

        def residuals(x: Array) -> Array:
            at = pose(x)
            seen = self.compare(at).residuals
            return (
                seen if noise is None else np.concatenate([seen, noise / usual * ((at.head - at.foot)[:2] - believed)])
            )

        def slopes(x: Array) -> Array:
            steps = DIFFERENCE * np.eye(4)
            return np.stack([(residuals(x + s) - residuals(x - s)) / (2 * DIFFERENCE) for s in steps], axis=1)

        fit = least_squares(residuals, np.zeros(4), jac=slopes, x_scale=1e-3, max_nfev=20)
        left = 2.0 * fit.cost / max(len(fit.fun) - 4, 1)
        information = fit.jac.T @ fit.jac + 1e-6 * left * np.eye(4) / DIFFERENCE**2
        variance = SPREAD**2 * left if noise is None else noise**2
        covariance = variance * np.linalg.inv(information)
        return Fit(pose(fit.x), covariance, self.compare(pose(fit.x)), 2.0 * float(fit.cost))


def whitening(left: Array) -> Array:
    """Mixtures of channels that have nothing in common and the variance one.

    Args:
        left: What is left of channels in some pixels, (m, n).

    Returns:
        The mixtures, (n, n): `left` times them is white.
    """
    n = left.shape[1]
    covariance = left.T @ left / max(len(left), 1)
    return np.asarray(np.linalg.cholesky(np.linalg.inv(covariance + FAINT**2 * np.trace(covariance) / n * np.eye(n))))


def fit_as_set(view: View, start: NailPose, anyhow: Fit) -> Fit:
    """Fit a nail that a person has set: upright but for the usual lean, unless the image surely tells another.

    A nail is a line of a few pixels, and its head one of two: what a longer or a shorter one would show, along the line
    of sight, differs by little, and by less than the grain of some wood.

    Args:
        view: The image.
        start: An upright nail near to where it stands.
        anyhow: The fit from there for which every lean is as good.

    Returns:
        The fit. Its covariance is of this optimum alone, and knows nothing of others that leave little more.
    """
    noise = SPREAD * float(np.sqrt(anyhow.comparison.left))
    usual = min((view.fit(one, noise) for one in _upright(start, anyhow.pose)), key=lambda fit: fit.misfit)
    return usual if usual.misfit < anyhow.misfit + (OVERRULED * noise) ** 2 else anyhow


def _upright(start: NailPose, leaning: NailPose) -> Sequence[NailPose]:
    """Where fits of an upright nail begin: at the start, and with the foot and with the head of a nail that leans."""
    up = start.head - start.foot
    return [start, NailPose(leaning.foot, leaning.foot + up), NailPose(leaning.head - up, leaning.head)]


SEARCH, STEP = 0.018, 0.0012
"""How far from where it is believed a nail is looked for on the wood, and in which steps [m]: three deviations of a
camera that is 2 mm and 0.3 deg off at a metre."""
BLURS = (0.3, 0.5, 0.8, 1.3)
"""Blurs of cameras that are tried [pixel]; the one that explains the first image best is this camera's."""
MARGIN, WIDE = 3.0, 4.0
"""What is compared around foot and head where the nail is looked for, and where its pose is fitted [pixel]."""
EXPLAINED = 0.4
"""Least share of the variance around a nail that is the nail."""
NEARER, SPECKS = 0.06, 0.05
"""What is nearer to the camera than the nail by so much hides it [m], if it is more than this share of the pixels."""
SEEN_PART = 0.3
"""Least share of the pixels around a nail whose depth is known: else nothing tells that it is not hidden. Also the
least share that has to show wood."""
SHOWN = 0.5
"""Least share of a head that has to show before wood to tell its colour."""
SURE, LEAST = 3.0, 3e-4
"""Within so many standard deviations every displacement that may be has to be longer than this [m]. Chosen on other
labs than those whose figures `benchmarks/bent_nails.py` gives."""
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
        self._set: AsSet | None = None

    def first(self, frames: Sequence[RgbdFrame], height: float, others: Sequence[NailPose] = ()) -> HeadOffset | None:
        """See the nail as it was set.

        Args:
            frames: Images of it.
            height: Height of its head over the wood [m].
            others: Where other nails are believed to stand in the same wood: none of them is taken for this one.

        Returns:
            How far its head is from its axis as believed, through its foot; None where it is hidden, outside of the
            image or not found.
        """
        seen = self._in_sight(frames, self._standing(self._believed, height))
        if not seen:
            return None
        image, wood = _mean(seen), self._wood(seen)
        found = self._find(frames[0], image, wood, height, others)
        window = None if found is None else self._look(frames[0], BLURS[0]).window(found, WIDE)
        if found is None or window is None:
            return None
        part, counted = window.cut(image), window.cut(wood)
        slope = float(self._axis[0]), float(self._axis[1])
        views = [View(self._look(frames[0], blur), window, part, counted, slope=slope) for blur in BLURS]
        fit = min((view.fit(found) for view in views), key=lambda fit: fit.misfit)
        # What a nail leaves is the grain, which is of the wood's hue: by what is of another hue a nail is seen better.
        white = part @ whitening(fit.comparison.residuals.reshape(-1, part.shape[2]))
        fits = [replace(view, image=white).fit(start) for view in views for start in (found, fit.pose)]
        best = int(np.argmin([fit.misfit for fit in fits]))
        view = views[best // 2]
        fit = fit_as_set(replace(view, image=white), found, fits[best])
        comparison = view.compare(fit.pose)
        if comparison.explained < EXPLAINED:
            return None
        head = view.look.covered(window, fit.pose)[:, 1]
        # A head at the block's edge, of which few pixels count, has no colour of its own: it is of the shank's steel.
        shown = head[counted.ravel()].sum() >= SHOWN * head.sum()
        colours = comparison.colours if shown else comparison.colours[[0, 0]]
        self._set = AsSet(view.look, fit.pose, fit.covariance, colours, image, wood)
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
        if self._set is None:
            return None
        before = self._set
        foot, head = before.pose.foot, before.pose.head
        share = height / (head - foot)[2]
        expected = NailPose(foot, foot + share * (head - foot))
        seen = self._in_sight(frames, expected)
        if not seen or seen[0].rgb.shape != before.image.shape:
            return None
        window = _around(before.look, expected, REACH, before.image.shape)
        counted = self._wood(seen) & ~self._hidden(seen, before.look.depth(expected.head))
        if np.mean(window.cut(counted & before.wood)) < SEEN_PART:
            return None
        onto = np.vstack([np.eye(2, 4), np.hstack([(1.0 - share) * np.eye(2), share * np.eye(2)])])
        change = Change(before, _mean(seen), window, counted)
        moved = fit_moved(change, expected, onto @ before.covariance @ onto.T)
        ray = expected.head - self._camera
        along = ray[:2] / ray[2]  # a head that is higher than believed looks as if it were nearer to the camera
        return HeadOffset(moved.offset, moved.covariance + sigma**2 * np.outer(along, along))

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

    def _hidden(self, frames: Sequence[RgbdFrame], depth: float) -> NDArray[np.bool_]:
        """Which pixels show something that is nearer to the camera than the nail, in any frame."""
        nearer = np.any([(frame.depth > 0.0) & (frame.depth < depth - NEARER) for frame in frames], axis=0)
        return _widened(nearer)

    def _wood(self, frames: Sequence[RgbdFrame]) -> NDArray[np.bool_]:
        """Which pixels show the wood, or what stands on it: the edge of a block looks much like a nail."""
        K, up = frames[0].intrinsics, self._X_camera_base[:3, 2]
        distance = up @ transform_points(self._X_camera_base, self._believed[None])[0]
        depths = np.stack([frame.depth for frame in frames])
        rows, columns = np.indices(depths.shape[1:])
        wood = distance / (K.rays(np.stack([columns, rows], axis=-1)) @ up)
        # In most of the frames that know their depth; what is unknown, 0 or NaN, is neither.
        behind = 2 * np.sum(depths > wood + BEHIND, axis=0) > np.sum(depths > 0.0, axis=0)
        return ~_widened(behind)

    def _find(
        self,
        frame: RgbdFrame,
        image: NDArray[np.float64],
        wood: NDArray[np.bool_],
        height: float,
        others: Sequence[NailPose],
    ) -> NailPose | None:
        """Look for a nail that stands as believed around the place where it is believed.

        A calibration that is off displaces all nails alike, so that the others are to be found where it is, too.
        """
        look, best = self._look(frame, BLURS[len(BLURS) // 2]), None

        def gain(pose: NailPose) -> float | None:
            """By how much a nail there explains the image better; None where there is no wood."""
            window = look.window(pose, MARGIN)
            if window is None or np.mean(window.cut(wood)) < SEEN_PART:
                return None
            compared = look.compare(window.cut(image), window, pose, window.cut(wood))
            return float(np.sum(compared.without**2) - np.sum(compared.residuals**2))

        steps = np.arange(-SEARCH, SEARCH + 0.5 * STEP, STEP)
        for x in steps:
            for y in steps[np.hypot(x, steps) <= SEARCH]:
                away = np.array([x, y, 0.0])
                pose = self._standing(self._believed + away, height)
                if (own := gain(pose)) is None:
                    continue
                total = own + sum(gain(NailPose(o.foot + away, o.head + away)) or 0.0 for o in others)
                if best is None or total > best[0]:
                    best = total, pose
        return None if best is None else best[1]


def _around(look: Appearance, pose: NailPose, reach: float, shape: Sequence[int]) -> Window:
    """The part of an image, of this shape, in which a nail may be whose foot and head are off by so much [m]."""
    corners = look.pixels(np.stack([pose.foot, pose.head]))
    margin = WIDE + reach * look.scale(pose.foot)
    left, top = np.maximum(np.floor(corners.min(axis=0) - margin), 0.0).astype(int).tolist()
    right, bottom = (np.ceil(corners.max(axis=0) + margin).astype(int) + 1).tolist()
    return Window(left, top, min(right, shape[1]), min(bottom, shape[0]))


def _mean(frames: Sequence[RgbdFrame]) -> NDArray[np.float64]:
    """The mean of their colour images, (H, W, 3)."""
    return np.asarray(np.mean([frame.rgb for frame in frames], axis=0))


def _widened(pixels: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels and those within `EDGE` of them, (H, W)."""
    return cv2.dilate(pixels.astype(np.uint8), np.ones((2 * EDGE + 1, 2 * EDGE + 1), np.uint8)) > 0
