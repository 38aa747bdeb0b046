"""A rehearsal: a lab's station, as its file says, with every device emulated in front of a simulated cell.

    config = load_lab_station(path)
    cell = job_cell(config, path, seed=3)
    with EmulatedLab(cell, print, real_time_factor=0.25, profile="harsh") as lab:
        HammeringTask(lab.station, perception, cell.measured, measured_grasp(cell.measured.tool, cell.measured)).run()

The drivers are the lab's, over the wires and protocols of its devices: `LabStation` builds them, and gets nothing but
other addresses. What the station file says of the cell is what a person measured, so the simulated cell differs from
it: see `job`.
"""

from toolee_robot.stations.rehearsal.emulated_lab import Cell, EmulatedLab, job_cell, job_errors
