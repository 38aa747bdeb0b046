"""The controller stand-in with the simulated world as its plant, in a child process of the task's."""

from __future__ import annotations

import signal
from multiprocessing.connection import Connection

from toolee_robot.config import StationConfig
from toolee_robot.errors import TooleeError
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.ur_controller.controller import Controller, ControllerOptions
from toolee_robot.sim_backend.ur_controller.world_plant import WorldPlant
from toolee_robot.sim_backend.ur_controller.world_service import WorldService


def run_world(
    connection: Connection, config: StationConfig, seed: int, options: SimOptions, controller: ControllerOptions
) -> None:
    """Serve `controller`'s ports, and `connection` with everything else, until the other end of it is closed.

    Sends (True, None) once the ports are open, or (False, error) when they cannot be. An interrupt from the terminal is
    left to the task: its clients have to go before this server does.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        service = WorldService(connection, config, seed, options, ended=lambda: server.stop())
        server = Controller(controller, lambda model: WorldPlant(service.world, model.period))
        server.add_service(service)
        service.offer("controller.statistics", lambda: server.schedule.statistics)
        server.listen()
    except TooleeError as error:
        connection.send((False, error))
        return
    connection.send((True, None))
    server.run()
