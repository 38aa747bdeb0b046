"""Simulated labs whose nail is straight, leans or is bent, and what the camera's view of it says in each.

    python -m benchmarks.bent_nails --seed 41000 --runs 200

Drawn from the seed, and unknown to whoever looks: room, lamps and wood, how the calibration of the camera is off, how
the nail was set, how far it is driven, and how far the measured height of its head is off.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array, transform
from toolee_robot.perception.nail.appearance import NailPose
from toolee_robot.perception.nail.sight import HeadOffset, NailSight
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.station import SimStation
from toolee_robot.station import StationConfig, load_station, sim_station
from toolee_robot.tasks.hammering.nail_watch import is_aside, is_bent, leans
from toolee_robot.types import RgbdFrame

CAMERA, CAMERA_ANGLE = 0.002, np.deg2rad(0.3)
"""Nominal error of the camera's calibration, about each axis [m], [rad]."""
LEAN = np.deg2rad(2.0)
"""Nominal lean of a nail, to each side [rad]."""
HEIGHT = 3e-4
"""Error of the measured height of the head [m]."""
SIGMA = 5e-4
"""What a job takes for that error [m]."""
FRAMES = 2
"""Images of a look."""
DRIVEN = 0.003, 0.017
"""Range of heights of a nail that has been driven [m]."""
PUSHED, BENT = (0.003, 0.008), (np.deg2rad(10.0), np.deg2rad(60.0))
"""How far the heads of bent nails are pushed aside [m], and by what angle the nails are bent [rad]."""
FLUSH = 5e-4
"""Height of the nails that were driven before [m]."""
LEANS = np.deg2rad(12.0), np.deg2rad(25.0)
"""Lean of nails that are not to be struck [rad]."""
SOONER = 0.001, 0.004
"""How far two strikes drive a nail from one look to the next [m]."""
FURTHER, LARGEST = (1.0, 1.3), np.deg2rad(70.0)
"""By what factor two strikes bend a bent nail further, and up to which angle [rad]; assumed."""


@dataclass(frozen=True, eq=False)
class Seen:
    """What looks at a nail said.

    Attributes:
        kind: `straight`, `bent`, or, as it was set, `set` or `leaning`.
        height: Height of the head over the wood [m].
        offset: True displacement of the head from the axis on which the nail was set, or of a nail as it was set, of
            its head from its foot, x and y of `base`, (2,) [m].
        found: What was seen; None if nothing was.
        later: What was seen of a driven nail two strikes later; None if nothing was.
    """

    kind: str
    height: float
    offset: Array
    found: HeadOffset | None
    later: HeadOffset | None = None


def look_at_nails(seed: int, config: StationConfig | None = None) -> Iterator[Seen]:
    """Look at the nails of one simulated lab."""
    rng = np.random.default_rng([seed, 28])
    off = transform(Rotation.from_rotvec(rng.normal(0.0, CAMERA_ANGLE, 3)), rng.normal(0.0, CAMERA, 3))
    lean = rng.normal(0.0, LEAN, 2)
    config = sim_station() if config is None else config
    yield from _looks(seed, config, off, lean, "set", rng)
    direction, size = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(*LEANS)
    lean = size * np.array([np.cos(direction), np.sin(direction)])
    yield from _looks(seed, config, off, lean, "leaning", rng)


def _looks(
    seed: int, config: StationConfig, off: Array, lean: Array, kind: str, rng: np.random.Generator
) -> Iterator[Seen]:
    names = config.work.names
    which = seed % len(names)
    work = config.work.only(names[which])
    foot = work.p_base_entry
    X_base_camera = config.camera.X_base_camera @ off
    sight = NailSight(X_base_camera, foot, work.nail_diameter, work.nail_head_diameter)
    leans = tuple((float(lean[0]), float(lean[1])) if name == names[which] else (0.0, 0.0) for name in names)
    options = SimOptions(hands_over=False, nail_leans=leans)
    with SimStation.build(config, seed, options) as simulation:
        nail = simulation.world.nails[names[which]]
        for name in names[:which]:
            simulation.world.nails[name].place(FLUSH)

        def head() -> Array:
            return np.asarray(nail.head_pose()[:3, 3] - nail.X_world_surface[:3, 3])

        def frames() -> Sequence[RgbdFrame]:
            return [simulation.station.camera.read() for _ in range(FRAMES)]

        others = [
            NailPose(other.p_base_entry, other.X_base_nail()[:3, 3])
            for other in map(config.work.only, names[which + 1 :])
        ]
        set_so = head()
        found = sight.first(frames(), float(set_so[2] + rng.normal(0.0, HEIGHT)), others)
        yield Seen(kind, float(set_so[2]), set_so[:2], found)
        if kind == "leaning":
            return
        for what in ("straight", "bent"):
            protrusion, bend = _driven(what, rng)
            nail.place(protrusion, bend)
            at = head()
            found = sight.again(frames(), float(at[2] + rng.normal(0.0, HEIGHT)), SIGMA)
            nail.place(*_struck_twice(protrusion, bend, rng))
            later = sight.again(frames(), float(head()[2] + rng.normal(0.0, HEIGHT)), SIGMA)
            yield Seen(what, float(at[2]), (at - at[2] / set_so[2] * set_so)[:2], found, later)


def _driven(kind: str, rng: np.random.Generator) -> tuple[float, tuple[float, float]]:
    """Protrusion [m] and bend [rad] of a nail that has been struck."""
    if kind == "straight":
        return float(rng.uniform(*DRIVEN)), (0.0, 0.0)
    while True:
        pushed, angle, direction = rng.uniform(*PUSHED), rng.uniform(*BENT), rng.uniform(0.0, 2.0 * np.pi)
        if DRIVEN[0] <= (protrusion := pushed / np.sin(angle)) <= DRIVEN[1]:
            return float(protrusion), (float(angle * np.cos(direction)), float(angle * np.sin(direction)))


def _struck_twice(
    protrusion: float, bend: tuple[float, float], rng: np.random.Generator
) -> tuple[float, tuple[float, float]]:
    """Protrusion [m] and bend [rad] of a driven nail after two more strikes."""
    angle = float(np.hypot(*bend))
    factor = 1.0 if angle == 0.0 else min(float(rng.uniform(*FURTHER)), LARGEST / angle)
    return max(protrusion - float(rng.uniform(*SOONER)), 0.001), (factor * bend[0], factor * bend[1])


KINDS = {
    "bent": "bent, head 3 to 8 mm aside",
    "leaning": "leans by 12 to 25 deg as set",
    "straight": "straight, driven",
    "set": "straight, as set",
}
LEAST_SEEN, MOST_FALSE = 0.95, 0.02
"""Share of bent nails that is to be seen at least, and of straight ones that may be taken for bent ones."""


def _alarms(looks: Sequence[Seen]) -> tuple[int, int]:
    """How many of one kind are taken for bent or leaning, and how many end a job."""
    found = [(look, look.found) for look in looks if look.found is not None]
    if looks[0].kind in ("set", "leaning"):
        alarms = sum(leans(offset, look.height) for look, offset in found)
        return alarms, alarms
    return sum(is_aside(offset) for _, offset in found), sum(is_bent(offset, look.later) for look, offset in found)


def main(arguments: Sequence[str] | None = None) -> int:
    """Look at the nails of many labs and print what was seen; 1 where a figure is not met."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bent_nails", description="Look at nails in many labs.")
    parser.add_argument("--runs", type=int, default=100, help="simulated labs")
    parser.add_argument("--seed", type=int, default=0, help="of the first; the others follow")
    parser.add_argument("--config", type=Path, help="station file with several nails, such as examples/nails.yaml")
    asked = parser.parse_args(arguments)
    config = None if asked.config is None else load_station(asked.config)
    looks = [look for k in range(asked.runs) for look in look_at_nails(asked.seed + k, config)]
    seen = wrong = 0.0
    for kind, words in KINDS.items():
        mine = [look for look in looks if look.kind == kind]
        alarms, ends = _alarms(mine)
        off = [1e3 * float(np.linalg.norm(s.found.offset - s.offset)) for s in mine if s.found is not None]
        median, most = np.quantile(off, [0.5, 0.95]) if off else (np.nan, np.nan)
        print(f"{words}: {alarms} of {len(mine)} taken for bent or leaning, {ends} end the job")
        print(f"  {len(mine) - len(off)} not seen, head off by {median:.1f} mm, 95 %: {most:.1f} mm")
        seen += alarms / len(mine) if kind == "bent" else 0.0
        wrong += alarms / asked.runs if kind in ("straight", "set") else 0.0
    return int(seen < LEAST_SEEN or wrong > MOST_FALSE)


if __name__ == "__main__":
    sys.exit(main())
