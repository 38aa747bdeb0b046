"""How far a strike's energy drives a nail, by the balance with the wood's resistance."""

from __future__ import annotations

import numpy as np

from toolee_robot.sim_backend.physics.wood import NailSpec, resistance


def driven_by(spec: NailSpec, start: float, energy: float) -> float:
    """How far [m] `energy` [J] drives the nail that stands at protrusion `start` [m]; at most down to flush (0)."""
    protrusions = np.linspace(start, 0.0, 2000)
    forces = np.array([resistance(spec, p) for p in protrusions])
    steps = start / (len(protrusions) - 1)
    work = np.concatenate([[0.0], np.cumsum((forces[1:] + forces[:-1]) / 2 * steps)])
    return float(np.interp(energy, work, start - protrusions))
