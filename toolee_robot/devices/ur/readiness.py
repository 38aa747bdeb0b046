"""The check that a robot is ready, before the driver connects."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from toolee_robot.devices.ur.checks import UrExpected, check
from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.devices.ur.probe import probe
from toolee_robot.errors import NotReadyError
from toolee_robot.findings import Level
from toolee_robot.station import ArmLimits

PROBES: Final = 3
TIMING: Final = {"RTDE rate", "RTDE jitter", "clock"}
"""Names of the findings that load on this machine can cause; if only these fail, the probe is repeated, up to PROBES
times in all."""


@dataclass(frozen=True)
class Identity:
    """Which robot answered.

    Attributes:
        version: Version of the controller's software: major, minor, bugfix, build.
        serial: Serial number; None from a controller that does not report it.
    """

    version: tuple[int, int, int, int]
    serial: str | None


def require_ready(
    config: UrArmConfig, limits: ArmLimits, before: Identity | None = None, *, payload_set: bool = False
) -> Identity:
    """Probe the robot and check it against the configuration; nothing moves.

    Args:
        config: Address and expected installation of the robot.
        limits: Expected model and calibration.
        before: The robot of an earlier connection, which it must be; the TCP is then the driver's own, which sets it
            again and reads it back. None for the first connection, when it is the installation's.
        payload_set: Whether the driver has set a payload of its own, likewise.

    Returns:
        Which robot it is.

    Raises:
        NotReadyError: A check failed; the message lists everything a person must do first.
    """
    expected = UrExpected(limits.model, limits.calibration, payload=None if payload_set else config.payload)
    if before is not None:
        expected = replace(expected, serial=before.serial)
    elif config.tcp is not None:
        expected = replace(expected, tcp=np.array(config.tcp))
    for _ in range(PROBES):
        report = probe(config.host, clock=config.clock)
        failed = [finding for finding in check(report, expected) if finding.level is Level.FAIL]
        # Load on this machine during the probe is no fault of the robot; a controller clock that runs backwards or is
        # not reported is.
        quality = report.quality
        load_only = quality is not None and not quality.backward and all(f.name in TIMING for f in failed)
        if not failed or not load_only:
            break
    if failed or report.version is None:
        lines = "\n  ".join(map(str, failed))
        message = f"the robot at {config.host} is not ready:\n  {lines}"
        if failed and load_only:
            raise NotReadyError(message, code="not_ready.timing")
        raise NotReadyError(message, code="not_ready.checks_failed")
    return Identity(report.version, report.serial)
