"""Draw docs/concepts/frames.svg: the half turn between the pendant's Base and base_link, seen from above.

Example: `python scripts/frames_picture.py`
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np

from toolee_robot.control import RobotModel
from toolee_robot.frames import HALF_TURN
from toolee_robot.station import sim_station

mpl.use("svg")
import matplotlib.pyplot as plt
from matplotlib.patches import Circle

PICTURE = Path(__file__).parents[1] / "docs/concepts/frames.svg"
OURS, PENDANT, WRONG, ARM = "#1565c0", "#e65100", "#c62828", "#546e7a"


def draw(path: Path) -> None:
    """Draw the picture.

    Args:
        path: The SVG file.
    """
    config = sim_station()
    arm = RobotModel.of_station(config).arm
    q = np.zeros(6)
    q[1:] = config.scene.home[1:]
    flange = arm.fk(q)[:3, 3]
    chain = np.array([[0.0, 0.0], [0.0, flange[1]], flange[:2]])
    nail = np.array([*config.work.nail_xy, 0.0])
    ghost = HALF_TURN[:3, :3] @ nail

    mpl.rcParams.update({"svg.hashsalt": "frames", "svg.fonttype": "path", "font.size": 11})
    figure, axes = plt.subplots(figsize=(9.2, 5.0))
    axes.plot(chain[:, 0], chain[:, 1], color=ARM, lw=9, alpha=0.35, solid_capstyle="round", zorder=1)
    axes.text(0.36, flange[1] + 0.05, "arm, its base joint at 0", color=ARM, ha="center", va="bottom")
    axes.add_patch(Circle((0, 0), 0.095, color=ARM, alpha=0.5, zorder=2))
    for name, sign, colour, style in (("base_link", 1.0, OURS, "-"), ("pendant_base", -1.0, PENDANT, "--")):
        for label, direction in (("x", np.array([1.0, 0.0])), ("y", np.array([0.0, 1.0]))):
            tip = 0.30 * sign * direction
            axes.annotate(
                "",
                xy=(float(tip[0]), float(tip[1])),
                xytext=(0, 0),
                arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 2.4, "ls": style, "mutation_scale": 17},
                zorder=4,
            )
            axes.text(
                1.14 * float(tip[0]),
                1.14 * float(tip[1]),
                label,
                color=colour,
                fontweight="bold",
                ha="center",
                va="center",
                zorder=5,
            )
        axes.text(0.0, sign * 0.43, name, color=colour, fontweight="bold", ha="center", va="center")
    axes.plot(*nail[:2], "o", color=OURS, ms=9, zorder=6)
    for row, (text, colour) in enumerate(
        (
            ("nail", "black"),
            (f"base_link ({nail[0]:.2f}, {nail[1]:.2f})", OURS),
            (f"pendant_base ({ghost[0]:.2f}, {ghost[1]:.2f})", PENDANT),
        )
    ):
        axes.text(nail[0] + 0.05, nail[1] + 0.05 - 0.075 * row, text, color=colour, ha="left", va="center")
    axes.plot(*ghost[:2], "o", color=WRONG, ms=9, zorder=6)
    mistake = "where the station has the nail if\nthe pendant's numbers are entered\nas base_link's"
    axes.text(ghost[0], ghost[1] + 0.06, mistake, color=WRONG, ha="center", va="bottom")
    axes.annotate(
        "",
        xy=(0.97 * ghost[0], ghost[1] - 0.03),
        xytext=(nail[0], nail[1] - 0.06),
        arrowprops={"arrowstyle": "-|>", "color": WRONG, "ls": ":", "lw": 1.6, "connectionstyle": "arc3,rad=-0.68"},
    )
    axes.text(0.0, -0.70, "half a turn about z, which points at you", color=WRONG, ha="center", va="top")
    axes.set_xlim(-1.2, 1.4)
    axes.set_ylim(-0.80, 0.62)
    axes.set_aspect("equal")
    axes.set_axis_off()
    figure.savefig(path, bbox_inches="tight", metadata={"Date": None}, facecolor="white")
    plt.close(figure)


if __name__ == "__main__":
    draw(PICTURE)
