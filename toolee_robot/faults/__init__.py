"""Injection of the faults that arm, supervisor and task must survive, and measurement of their reactions.

    for row in run_matrix(MatrixOptions()):
        print(row.number, row.fault, row.handled)

Arm and network faults are injected into the controller stand-in under the real driver, faults of commands into the
supervisor in front of it, faults of hand, camera, person and nail into the simulated station under the real task, those
of hands and cameras also into emulated ones under their own drivers. The numbers are those of the list in
docs/concepts/safety.md.
"""
