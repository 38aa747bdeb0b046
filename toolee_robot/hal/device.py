"""Protocols of every device, of the clock, the camera and the hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self, runtime_checkable

from toolee_robot.frames import Array
from toolee_robot.types import CameraIntrinsics, JointState, RgbdFrame


class Device(Protocol):
    """A device that is opened, used, and left in a safe state."""

    def __enter__(self) -> Self:
        """Open the device.

        Raises:
            DeviceError: The device does not answer or is not ready.
        """

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Bring the device to a safe standstill and close it."""


@runtime_checkable
class Clock(Protocol):
    """The station's clock; in a simulation only motion and sleep advance it."""

    def now(self) -> float:
        """Return the present time [s]."""

    def sleep(self, duration: float) -> None:
        """Wait for `duration` [s] of the station's time."""


@runtime_checkable
class RgbdCamera(Device, Protocol):
    """A calibrated RGB-D camera."""

    @property
    def intrinsics(self) -> CameraIntrinsics:
        """Pinhole model of the undistorted colour image, to which the depth is registered."""

    def read(self, max_age: float = 0.5) -> RgbdFrame:
        """Return a frame that was exposed after the call began; repeated stamps never count as new frames.

        Args:
            max_age: Largest age of the frame [s].

        Raises:
            StaleDataError: No new frame came, or it is older than `max_age`.
            DeviceError: The camera does not answer.
        """


@dataclass(frozen=True)
class HandState:
    """State of the hand at one time.

    Attributes:
        joints: Measured state of the n joints in the order of `Hand.joint_names`, wrist first.
        contact_forces: Force on the pads of each finger [N], 0 without contact, by the finger's name in the hand's
            `HandModel`; "palm" as well where the hand can sense it.
        holding: Whether the hand itself judges that it holds an object. A mount senses nothing: there it is what a
            person said last.
        assisted: Whether the object is held by the simulation's assisted grip rather than by friction alone.
        temperature: Temperature of the hottest part [deg C]; None where the hand cannot measure it.
        fault: Description of the hand's fault (stalled, over current, ...); empty if none.
    """

    joints: JointState
    contact_forces: dict[str, float]
    holding: bool
    assisted: bool = False
    temperature: float | None = None
    fault: str = ""


@runtime_checkable
class Hand(Device, Protocol):
    """A dexterous hand. Its motions block until they are done; a time-out keeps the grip."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the n joints, wrist first."""

    def state(self, max_age: float = 0.1) -> HandState:
        """Return the newest state.

        Args:
            max_age: Largest age of the reading [s].

        Raises:
            StaleDataError: The newest reading is older than `max_age`.
            DeviceError: The hand does not answer.
        """

    def open(self, timeout: float = 5.0) -> None:
        """Spread the fingers.

        Args:
            timeout: Time for the motion [s].

        Raises:
            DeviceError: The motion timed out.
        """

    def close(self, timeout: float = 5.0) -> None:
        """Close the fingers until they hold an object or are shut.

        Args:
            timeout: Time for the motion [s].

        Raises:
            DeviceError: The motion timed out.
        """

    def stop(self) -> None:
        """Stop the fingers and keep the grip; the hand never releases the object."""


@runtime_checkable
class KeepsCourse(Protocol):
    """A hand that keeps what it measured, more closely than somebody else could ask for it."""

    def course(self, since: float) -> Sequence[tuple[float, Array]]:
        """The joints' positions, (n,) [rad], by time [s], since a time; those that are too old are forgotten."""


@runtime_checkable
class ClearsFaults(Protocol):
    """A hand whose faults stay until a person has looked and clears them; most hands have none of this kind."""

    def clear_faults(self) -> None:
        """Clear the faults that can be cleared; no finger is given a target.

        Raises:
            DeviceError: The hand does not take it.
        """
