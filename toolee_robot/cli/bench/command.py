"""`toolee bench`: latencies on this machine."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import cycle
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console
from rich.table import Table

from toolee_robot.cli.host_info import Latency, Machine, describe_machine, measure
from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line
from toolee_robot.end_effectors import Category
from toolee_robot.errors import TooleeError, UserError
from toolee_robot.types import HoldingHand

if TYPE_CHECKING:
    from toolee_robot.cli.bench.scene import BenchScene

_CANDIDATES = (1, 5, 10, 20, 32, 50)
_POSE_TARGET_MS, _PERCEPTION_TARGET_MS, _PLAN_TARGET_MS = 15.0, 350.0, 100.0
_HELD_TARGET_MS = {"float32": 150.0, "bfloat16": 100.0}
"""With the hand's pose: on two cores with AVX2, and with AMX, by the networks' arithmetic."""
_SEED = 100


@dataclass(frozen=True)
class Bench:
    """Measure latencies of perception and planning and the simulation's speed here.

    Example: toolee bench

    Medians and 90th percentiles of repeated calls, after calls that do not count. One call at a time, as on the robot.
    """

    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""
    repeats: Annotated[int, tyro.conf.arg(metavar="N")] = 20
    """Calls per measurement."""

    def run(self) -> int:
        if self.repeats < 3:
            raise UserError(f"--repeats {self.repeats}: give at least 3", code="user.repeats")
        console = Console(stderr=self.json, highlight=False)
        machine = describe_machine()
        console.print(_describe(machine))

        from toolee_robot.cli.bench.scene import bench_scene

        with ExitStack() as stack:
            # The status display uses a thread: not during measurements.
            with console.status("a hammer is handed over and brought before the camera"):
                scene = stack.enter_context(bench_scene(_SEED))
            held_target = _HELD_TARGET_MS[machine.arithmetic]
            latencies = [*_perception(scene, self.repeats, held_target), *_planning(scene, self.repeats)]
            real_time_factor = scene.simulation_speed()
        console.print(_table(latencies))
        console.print(
            "[dim]pose: encoder, sampling, pooling. strike plan: spin sweep, branches, collision, timing[/dim]"
        )
        console.print(f"simulation with the hammer held: {real_time_factor:.2f} x real time")
        if self.json:
            record = {
                "machine": asdict(machine),
                "latencies": [{**asdict(la), "met": la.met} for la in latencies],
                "simulation_real_time_factor": real_time_factor,
            }
            print(json_line(record), flush=True)
        return 0


def _describe(machine: Machine) -> str:
    versions = ", ".join(f"{name} {v}" for name, v in machine.versions.items())
    return (
        f"[bold]{machine.cpu}[/bold], {machine.cores} cores for this process, {machine.memory_gb} GB\n"
        f"{machine.system}, Python {machine.python}, torch on {machine.torch_threads} threads, "
        f"networks in {machine.arithmetic}\n[dim]{versions}[/dim]"
    )


def _table(latencies: list[Latency]) -> Table:
    table = Table()
    for name in ("what", "median", "p90", "target", ""):
        table.add_column(name, justify="left" if name in ("what", "") else "right")
    for la in latencies:
        verdict = "" if la.met is None else "[green]met[/green]" if la.met else "[red]missed[/red]"
        target = "" if la.target_ms is None else f"< {la.target_ms:.0f} ms"
        table.add_row(la.name, f"{la.median_ms:.2f} ms", f"{la.p90_ms:.2f} ms", target, verdict)
    return table


def _perception(scene: BenchScene, repeats: int, held_target_ms: float) -> Iterator[Latency]:
    from toolee_robot.perception import ToolPerception
    from toolee_robot.perception.cloud import ee_cloud

    frame = scene.frame
    hand = HoldingHand(scene.X_camera_hand, scene.robot.description.hand.grasp.R_hand_tool)
    perception = ToolPerception.load()
    yield measure(
        f"segmentation ({frame.intrinsics.width}x{frame.intrinsics.height})",
        lambda: perception.detector.detect(frame),
        repeats=repeats,
    )
    detections = perception.detector.detect(frame)
    usable = [(d, c) for d in detections if (c := ee_cloud(frame, d)).usable]
    if not usable:
        raise TooleeError(
            "the network sees no end effector in the benchmark's frame: its weights do not fit this code",
            code="toolee.bench_no_detection",
        )
    detection, cloud = next((u for u in usable if u[0].category is Category.HAMMER_HEAD), usable[0])
    yield measure("cloud, one end effector", lambda: ee_cloud(frame, detection), repeats=repeats)
    for k in _CANDIDATES:
        pose = partial(
            perception.pose.estimate,
            cloud.points,
            detection.category,
            cloud.rest,
            hand,
            candidates=k,
            completed=cloud.completed,
        )
        target = _POSE_TARGET_MS if k == perception.pose.candidates else None
        yield measure(f"pose, K = {k}", pose, repeats=repeats, target_ms=target)
    yield measure(
        f"perception, whole image (end effectors: {len(detections)})",
        lambda: perception.estimate(frame, hand),
        repeats=repeats,
        target_ms=_PERCEPTION_TARGET_MS,
    )
    near = replace(hand, region=scene.region)
    found, times = perception.estimate_timed(frame, near)
    where = "whole image after all" if times.whole_image else f"end effectors: {len(found)}"
    yield measure(
        f"perception about the hand, as in a job ({where})",
        lambda: perception.estimate(frame, near),
        repeats=repeats,
        target_ms=held_target_ms,
    )


def _planning(scene: BenchScene, repeats: int) -> Iterator[Latency]:
    ik = scene.robot.ik
    target = scene.robot.fk(scene.q_arm, scene.q_hand)[0]
    yield measure("inverse kinematics, all branches", lambda: ik.solve(target), repeats=10 * repeats)
    grasps = cycle(scene.random_grasps(repeats))
    yield measure(
        "strike plan",
        lambda: scene.plan(next(grasps)),
        repeats=repeats,
        target_ms=_PLAN_TARGET_MS,
    )


COMMANDS = {"": Bench}
