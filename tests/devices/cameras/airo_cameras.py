"""Cameras of airo-camera-toolkit's interface, without hardware; on its own base class where it is installed."""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import Any

import pytest

from tests.rigs.software_airo import SoftwareAiroCamera

INTERFACES = "airo_camera_toolkit.interfaces"
HERE = __name__

try:
    RGBDCamera: Any = importlib.import_module(INTERFACES).RGBDCamera
except ImportError:

    class RGBDCamera:  # type: ignore[no-redef]
        """Stands in for the toolkit's."""


def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The toolkit is there, or its base class alone."""
    if RGBDCamera.__module__ == HERE:
        interfaces: Any = ModuleType(INTERFACES)
        interfaces.RGBDCamera = RGBDCamera
        monkeypatch.setitem(sys.modules, INTERFACES, interfaces)


class OnTheirBase(SoftwareAiroCamera, RGBDCamera):
    """As the toolkit's cameras are."""


class LikeRealsense(OnTheirBase):
    """Takes what the toolkit's `Realsense` takes."""

    def __init__(
        self,
        resolution: tuple[int, int] = (1920, 1080),
        fps: int = 30,
        enable_pointcloud: bool = True,
        enable_hole_filling: bool = True,
        serial_number: str | None = None,
    ) -> None:
        super().__init__()
        self.given = (resolution, fps, enable_pointcloud, enable_hole_filling, serial_number)


class LikeZed(OnTheirBase):
    """Takes what the toolkit's `Zed` takes."""

    class InitParams:
        NEURAL_DEPTH_MODE, NONE_DEPTH_MODE = "neural", "none"

    def __init__(
        self,
        resolution: tuple[int, int] = (2208, 1242),
        fps: int = 15,
        depth_mode: str = InitParams.NONE_DEPTH_MODE,
        serial_number: int | None = None,
    ) -> None:
        super().__init__()
        self.given = (resolution, fps, depth_mode, serial_number)


class LikeReceiver(OnTheirBase):
    """Takes what the toolkit's receivers take, which have no serial number."""

    def __init__(self, shared_memory_namespace: str, fps: int = 30) -> None:  # noqa: ARG002
        super().__init__()
