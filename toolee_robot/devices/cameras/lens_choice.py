"""Which lens holds: the one that the camera tells, or the one that the station file states."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from toolee_robot.devices.cameras.lens import Lens, LensModel
from toolee_robot.errors import NotReadyError
from toolee_robot.types import CameraIntrinsics

SAME_LENS = 0.1
"""Largest difference of two lenses that are the same but for rounding [px]."""
OTHER_LENS = 0.05
"""Difference of a lens from what the camera tells above which it is another camera's, or of another mode, as a share of
the image's width. Assumed: some five times what a factory's calibration and a lab's differ by."""

REFUSED = frozenset(f"not_ready.camera_{what}" for what in ("size", "intrinsics", "distortion", "undistorted", "lens"))
"""Codes of the errors by which a lens that a station file states is refused (`choose_lens`)."""

UNKNOWN_LENS = (
    "give camera.distortion by a calibration with OpenCV or ROS; or, if the driver's images are undistorted, give "
    "camera.distortion: [0, 0, 0, 0]"
)
"""What a person does about a lens that nobody tells."""


class LensSource(StrEnum):
    """Where the lens that holds is from."""

    CAMERA = "the camera's own"
    FILE = "the station file's"
    RECORDING = "undistorted when it was recorded"


@dataclass(frozen=True)
class StatedLens:
    """What a station file states of the lens.

    Attributes:
        intrinsics: The pinhole model.
        distortion: k1, k2, p1, p2 and possibly k3 of OpenCV's model; None where the file does not say.
    """

    intrinsics: CameraIntrinsics
    distortion: tuple[float, ...] | None = None

    @property
    def lens(self) -> Lens:
        """The lens; without coefficients where the file does not say."""
        if self.distortion is None:
            return Lens(self.intrinsics, LensModel.UNKNOWN)
        return Lens(self.intrinsics, LensModel.BROWN_CONRADY, self.distortion)


@dataclass(frozen=True)
class ChosenLens:
    """The lens that holds.

    Attributes:
        lens: The lens by which images are undistorted.
        source: Where it is from.
        told: What the camera tells of its lens.
    """

    lens: Lens
    source: LensSource
    told: Lens

    @property
    def words(self) -> str:
        """The lens in words, such as "the camera's own, brown conrady: displaces pixels by up to 5.2 px"."""
        if not self.lens.known:
            return "distortion not known: treated as a pinhole camera"
        if self.source is LensSource.RECORDING:
            return str(self.source)
        if not self.lens.distorts:
            return f"{self.source}: no distortion"
        name = self.lens.model.replace("_", " ")
        return (
            f"{self.source}, {name}: displaces pixels by up to {self.lens.largest_displacement():.1f} px, undistorted "
            "here"
        )


def choose_lens(told: Lens, stated: StatedLens | None, *, undistorted: bool | None = False) -> ChosenLens:
    """Choose the lens that holds.

    The camera's own holds; where the camera tells no coefficients, those that the station file has. None is applied to
    images that were undistorted before, and the file's pinhole model must be theirs. What contradicts each other is
    refused.

    Args:
        told: What the camera tells.
        stated: What the station file states; None for nothing.
        undistorted: `CameraProfile.undistorted`.

    Returns:
        The lens.

    Raises:
        NotReadyError: The images have another size than the file says (`not_ready.camera_size`), the pinhole model is
            another one (`not_ready.camera_intrinsics`), or the lens is (`not_ready.camera_distortion`); or the file
            states a distortion, and nobody knows whether it was taken out (`not_ready.camera_undistorted`); or the
            coefficients are no lens's (`not_ready.camera_lens`).
    """
    own = LensSource.RECORDING if undistorted else LensSource.CAMERA
    if stated is None:
        return ChosenLens(told, own, told)
    mine, theirs = told.intrinsics, stated.intrinsics
    if (mine.width, mine.height) != (theirs.width, theirs.height):
        raise NotReadyError(
            f"the camera's images are {_size(mine)}, those of the station file {_size(theirs)}. Give the size of "
            "the calibration, or enter what `toolee camera show` prints",
            code="not_ready.camera_size",
        )
    if undistorted is None and stated.lens.distorts:
        raise NotReadyError(
            "the station file gives a distortion, but the recording does not say whether its images are "
            "undistorted. Record again, or add `undistorted: true` or `false` to its recording.json",
            code="not_ready.camera_undistorted",
        )
    if undistorted:
        if not mine.agrees(theirs):
            raise NotReadyError(
                f"the recording was undistorted to the intrinsics {_text(mine)}, the station file's are "
                f"{_text(theirs)}: record again with this file, or play it with the old file",
                code="not_ready.camera_intrinsics",
            )
        return ChosenLens(told, own, told)
    if stated.distortion is not None and not told.known:
        _check_near(told, stated)
        return ChosenLens(stated.lens, LensSource.FILE, told)
    if not mine.agrees(theirs):
        raise NotReadyError(
            f"the camera's intrinsics are {_text(mine)}, the station file's {_text(theirs)}: `toolee camera show` "
            "prints what to enter under camera",
            code="not_ready.camera_intrinsics",
        )
    if stated.distortion is not None and (off := told.largest_difference(stated.lens)) > SAME_LENS:
        raise NotReadyError(
            f"camera.distortion of the station file is not the camera's own: they differ by up to {off:.1f} px, and "
            "one is wrong. Leave it out to use the camera's own",
            code="not_ready.camera_distortion",
        )
    return ChosenLens(told, LensSource.CAMERA, told)


def _check_near(told: Lens, stated: StatedLens) -> None:
    """Refuse a lens that cannot be this camera's in this mode."""
    # A camera that tells no distortion may have any.
    off = Lens(told.intrinsics).largest_difference(Lens(stated.intrinsics))
    if off > OTHER_LENS * told.intrinsics.width:
        raise NotReadyError(
            f"camera.fx and the others shift pixels by up to {off:.0f} px from the camera's own intrinsics "
            f"({_text(told.intrinsics)}). They belong to another camera or mode: `toolee camera show` "
            "prints this one's",
            code="not_ready.camera_distortion",
        )


def _size(k: CameraIntrinsics) -> str:
    return f"{k.width}x{k.height}"


def _text(k: CameraIntrinsics) -> str:
    return f"{_size(k)}, {k.fx:.2f} {k.fy:.2f} {k.cx:.2f} {k.cy:.2f}"
