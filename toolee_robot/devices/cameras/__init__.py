"""Drivers of RGB-D cameras.

    with StreamedCamera(RecordedStream(Path("frames"), clock), clock) as camera:
        frame = camera.read()

A driver is a `CameraStream` (`stream`): it connects, and fetches pairs of raw images with the device's stamps. What
must hold for every camera is done once, by `StreamedCamera` (`camera`): the frame gate and the clock (`stream`), which
lens holds (`lens_choice`), undistortion and the registration of depth to colour (`lens`).
`recorded` plays what `recording` wrote; `realsense` and `orbbec` are the drivers.
"""

from toolee_robot.devices.cameras.camera import StreamedCamera
from toolee_robot.devices.cameras.lens import Lens, LensModel
from toolee_robot.devices.cameras.lens_choice import StatedLens
from toolee_robot.devices.cameras.stream import CameraProfile, CameraStream, RawImages
