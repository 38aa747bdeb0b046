"""A camera from a station file: nothing is assumed, another camera is refused, other packages' drivers are found."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from tests.devices.cameras.test_recording import INTRINSICS, SERIAL, toy_recording
from tests.errors import raises
from toolee_robot.devices.hands import open_hand, wired_hand
from toolee_robot.errors import ConfigError, NotReadyError
from toolee_robot.robots import hand_model
from toolee_robot.robots.hands import HAND_FILES
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.hands import emulated_hand
from toolee_robot.station import CameraConfig, CameraDevice, HandConfig, load_station, sim_station
from toolee_robot.stations.camera import camera_drivers, open_camera
from toolee_robot.stations.template import open_questions
from toolee_robot.types import HandEfforts, HandMounting


def config(device: CameraDevice | None) -> CameraConfig:
    k = INTRINSICS
    return replace(
        sim_station().camera, fx=k.fx, fy=k.fy, cx=k.cx, cy=k.cy, width=k.width, height=k.height, device=device
    )


def recorded(folder: Path, serial: str = SERIAL) -> CameraConfig:
    return config(CameraDevice("recorded", serial, 0.3, folder=str(folder)))


def test_the_file_names_driver_serial_and_range(tmp_path: Path) -> None:
    path = tmp_path / "lab.yaml"
    given = {"driver": "realsense", "serial": '"832112070123"', "least_range": "0.2"}
    for missing in (None, *given):
        lines = "".join(f"    {name}: {value}\n" for name, value in given.items() if name != missing)
        path.write_text(f"camera:\n  device:\n{lines}")
        if missing is None:
            device = load_station(path).camera.device
            assert device == CameraDevice("realsense", "832112070123", 0.2)
        else:
            with raises(ConfigError) as raised:
                load_station(path)
            assert f"camera.device.{missing}" in str(raised.value)


def test_what_the_file_lacks_is_named() -> None:
    clock = HostClock()
    with raises(ConfigError, says="camera.device is missing"):
        open_camera(config(None), clock)
    with raises(ConfigError, says="'kinect' is unknown") as raised:
        open_camera(config(CameraDevice("kinect", "1", 0.5)), clock)
    assert "realsense" in str(raised.value)
    with raises(ConfigError, says="camera.device.folder is missing"):
        open_camera(config(CameraDevice("recorded", "1", 0.5)), clock)


def test_an_exposure_is_refused_where_the_driver_sets_none() -> None:
    with raises(ConfigError, says="camera.device.exposure"):
        open_camera(config(CameraDevice("orbbec", "0042", 0.3, exposure=0.01)), HostClock())


def test_another_camera_and_another_lens_are_refused(tmp_path: Path) -> None:
    toy_recording(tmp_path / "r")
    clock = HostClock()
    with open_camera(recorded(tmp_path / "r"), clock) as camera:
        assert camera.profile.serial == SERIAL
    with raises(NotReadyError, "not_ready.camera_serial"), open_camera(recorded(tmp_path / "r", "78"), clock):
        pass
    zoomed = replace(recorded(tmp_path / "r"), fx=INTRINSICS.fx + 0.1)
    with raises(NotReadyError, "not_ready.camera_intrinsics"), open_camera(zoomed, clock):
        pass
    with open_camera(replace(zoomed, fx=INTRINSICS.fx + 0.004), clock):
        pass
    with open_camera(zoomed, clock, check_intrinsics=False) as camera:
        assert camera.intrinsics == INTRINSICS


def test_a_labs_own_driver_is_found_by_its_entry_point(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    toy_recording(tmp_path / "r")
    code = (
        "from pathlib import Path\n"
        "from toolee_robot.devices.cameras.recording import RecordedStream\n"
        "def open_stream(config, device, clock):\n"
        "    return RecordedStream(Path(__file__).parent / 'r', clock)\n"
    )
    _install(tmp_path, "our_lab", code, {"camera.ours": "open_stream", "camera.gone": "no_such"})
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    assert camera_drivers()["ours"] == "our_lab:open_stream"
    with open_camera(config(CameraDevice("ours", SERIAL, 0.3)), HostClock()) as camera:
        assert camera.profile.serial == SERIAL
    with raises(ConfigError, says="which cannot be imported") as raised:
        open_camera(config(CameraDevice("gone", SERIAL, 0.3)), HostClock())
    assert "our_lab" in str(raised.value)


MOUNTING = HandMounting(position=(0.0, 0.0, 0.08), fingers=(0.0, 0.0, 1.0), thumb=(1.0, 0.0, 0.0))


def _install(folder: Path, package: str, code: str, names: dict[str, str]) -> None:
    """Install a package of one module; `names` are its entry points and what in the module each names."""
    (folder / f"{package}.py").write_text(code)
    info = folder / f"{package}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    entries = "".join(f"{entry} = {package}:{name}\n" for entry, name in names.items())
    (info / "entry_points.txt").write_text(f"[toolee_robot.devices]\n{entries}")


OURS = """
from dataclasses import replace

from toolee_robot.robots.hands import INSPIRE_RH56
from toolee_robot.devices.hands.inspire import KIND
from toolee_robot.sim_backend.hands.inspire import emulate as EMULATOR

MODEL = replace(INSPIRE_RH56, name="ours", label="our hand")
"""


def test_a_labs_own_package_brings_a_whole_hand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Model, driver and emulator, and nothing of this project is edited."""
    names = {
        "hand.ours": "KIND",
        "hand_model.ours": "MODEL",
        "hand_emulator.ours": "EMULATOR",
        "hand_model.other": "MODEL",
    }
    _install(tmp_path, "our_whole_hand", OURS, names)
    with raises(ConfigError, "config"):
        hand_model("ours")
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    config = HandConfig("ours", mounting=MOUNTING)
    assert hand_model(config).label == "our hand"
    with raises(ConfigError, says="is no HandModel of the name"):
        hand_model("other")
    asked = {question.name for question in open_questions({"hand": {"model": "ours"}})}
    assert {"hand.port", "hand.weighed.mass", "hand.mounting.fingers"} <= asked
    with emulated_hand(config) as emulator, open_hand(replace(config, port=emulator.port), HostClock()) as hand:
        assert hand.joint_names == hand_model(config).joints
        assert not hand.state(max_age=2.0).holding
    with raises(ConfigError, "config.hand_port"):
        open_hand(replace(config, port="ws://127.0.0.1:1"), HostClock())


def test_every_hand_on_a_wire_has_an_emulator() -> None:
    for name in HAND_FILES:
        assert wired_hand(name) is not None
        with emulated_hand(HandConfig(name)) as emulator:
            assert emulator.port.startswith({"sh": "ws://127.0.0.1:", "ro": "tcp://127.0.0.1:"}.get(name[:2], "/dev/"))
    with emulated_hand(HandConfig("inspire_rh56", port="tcp://192.168.11.210:6000")) as emulator:
        assert emulator.port.startswith("tcp://127.0.0.1:"), "not at the real hand's address"
    with raises(ConfigError, says="emulator"):
        emulated_hand(HandConfig("three_finger"))


@pytest.mark.parametrize(
    ("model", "port"),
    [
        ("ability_hand", "tcp://192.168.11.210:6000"),
        ("inspire_rh56", "tcp://192.168.11.210"),
        ("inspire_rh56", "ws://192.168.11.210:9090"),
        ("shadow_right", "tcp://192.168.11.210:9090"),
        ("shadow_right", "/dev/ttyUSB0"),
        ("robotiq_2f85", "/dev/ttyUSB0"),
        ("robotiq_2f85", "192.168.56.101:63352"),
    ],
)
def test_a_port_that_the_hand_cannot_have(model: str, port: str) -> None:
    mounting = None if model == "shadow_right" else MOUNTING
    config = HandConfig(model, port=port, mounting=mounting, efforts=HandEfforts(60.0, 300.0, 0.03))
    with raises(ConfigError, "config.hand_port"):
        open_hand(config, HostClock())


def test_a_shadow_hand_needs_what_only_a_lab_can_measure() -> None:
    with raises(ConfigError, "config.hand_port"):
        open_hand(HandConfig("shadow_right"), HostClock())
    with raises(ConfigError, "config.hand_efforts") as lacking:
        open_hand(HandConfig("shadow_right", port="ws://127.0.0.1:9090"), HostClock())
    assert "hand.efforts.newtons_per_unit" in str(lacking.value)
    efforts = HandEfforts(60.0, 300.0, 0.03)
    numbered = HandConfig("shadow_right", port="ws://127.0.0.1:9090", hand_id=3, efforts=efforts)
    with raises(ConfigError, says="hand.hand_id"):
        open_hand(numbered, HostClock())
    with pytest.raises(ValueError, match="must be more than"):
        HandEfforts(60.0, 50.0, 0.03)
