"""A rehearsal: a lab's station, as its file says, with every device emulated in front of a simulated world.

The drivers are the lab's, over the wires and protocols of its devices: `LabStation` builds them, and gets nothing but
other addresses. What the station file says of the cell is what a person measured, so the simulated cell differs from
it: see `cell`.
"""

from toolee_robot.stations.rehearsal.station import Rehearsal

__all__ = ["Rehearsal"]
