"""A second hand, for tests: three fingers and a thumb, other joints and links than the Shadow Hand's, no wrist."""

from __future__ import annotations

from pathlib import Path

from scipy.spatial.transform import Rotation

from toolee_robot.frames import transform
from toolee_robot.robots.hands import Finger, HandModel, NominalGrasp, Phalanx
from toolee_robot.robots.urdf import read_urdf


def _finger(name: str, lower: tuple[float, float], upper: tuple[float, float]) -> Finger:
    links = (f"{name}_lower", f"{name}_upper")
    phalanges = (Phalanx(links[0], *lower), Phalanx(links[1], *upper))  # radius, length [m]
    return Finger(name, links, phalanges)


_BENDS, _CURLS = ("a_bend", "b_bend", "c_bend"), ("a_curl", "b_curl", "c_curl")

THREE_FINGER_HAND = HandModel(
    name="three_finger",
    label="three-finger hand",
    source=Path(__file__).with_name("three_finger.urdf"),
    read=read_urdf,
    X_flange_root=transform(Rotation.from_euler("z", 90, degrees=True), [0.0, 0.0, 0.012]),  # a plate of 12 mm
    frame="gripper_palm",
    wrist=(),
    fingers=(
        _finger("opposer", (0.010, 0.055), (0.009, 0.040)),
        *(_finger(name, (0.009, 0.055), (0.008, 0.045)) for name in "abc"),
    ),
    finger_joints=("a_bend", "a_curl", "b_bend", "b_curl", "c_bend", "c_curl", "opposer_bend", "opposer_curl"),
    forearm=(),
    postures={
        "open": {},
        "preshape": dict.fromkeys(_BENDS, 0.8),
        "closed": dict.fromkeys((*_BENDS, *_CURLS), 1.9) | {"opposer_bend": 2.4, "opposer_curl": 1.9},
    },
    closing_order=(_BENDS, _CURLS, ("opposer_bend",), ("opposer_curl",)),
    wrapping_order=(_BENDS, _CURLS, ("opposer_bend",), ("opposer_curl",)),
    # The handle's axis is along x; it touches the palm's face and the bent fingers.
    grasp=NominalGrasp(z=(1.0, 0.0, 0.0), x=(0.0, 0.0, 1.0), p=(0.0, -0.015, 0.081), p_per_radius=(0.0, -1.0, -1.0)),
    holding_links=3,
    finger_force=20.0,
    grip_width=0.07,
)
