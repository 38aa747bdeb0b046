"""Train the pose network on one CUDA GPU, on several, or, for a look, on a CPU.

    python -m toolee_robot.perception.train_pose --out runs/pose --minutes 20
    torchrun --nproc-per-node 4 -m toolee_robot.perception.train_pose --out runs/pose --minutes 20
    python -m toolee_robot.perception.train_pose --out runs/paper --minutes 20 --estimator paper --column ee

Writes pose-*.safetensors and pose.json (settings, validation on held-out tools, calibration; with --estimator paper:
pose_paper-*), log.jsonl, and checkpoint.pt; the same command again resumes from it. Where gymnasium-robotics is not
installed, carry the hand's surface samples there:

    python -m toolee_robot.perception.train_pose --prepare-hands hands.npz
    python -m toolee_robot.perception.train_pose --out runs/pose --minutes 20 --hands hands.npz
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import MISSING, fields
from pathlib import Path

from toolee_robot.errors import TooleeError, UserError
from toolee_robot.perception.pose.bank import save_hands
from toolee_robot.perception.pose.cloud_batch import PROTOCOLS
from toolee_robot.perception.pose.method import Ours
from toolee_robot.perception.pose.paper import COLUMNS, PaperMethod, column_of
from toolee_robot.perception.pose.train_config import TrainConfig
from toolee_robot.perception.pose.training import train


def main(arguments: list[str] | None = None) -> int:
    """The command; returns the exit code."""
    parser = argparse.ArgumentParser(prog="train_pose", description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, help="folder for the weights, the log and the checkpoint")
    parser.add_argument("--estimator", choices=("ours", "paper"), default="ours", help="paper: ToolEENet's own")
    parser.add_argument("--column", choices=tuple(COLUMNS), help="of the paper's Table I (default: symmetry-aware)")
    parser.add_argument(
        "--protocol", choices=tuple(PROTOCOLS), default="hard", help="of the clouds, as of the data set's"
    )
    parser.add_argument("--init", type=Path, help="folder of weights to start from")
    parser.add_argument("--hands", type=Path, help="hand samples written by --prepare-hands")
    parser.add_argument("--rendered", type=Path, nargs="+", default=[], help="files of `toolee train clouds` to mix in")
    parser.add_argument("--calibrate-only", action="store_true", help="validate and calibrate the weights in --out")
    parser.add_argument("--prepare-hands", type=Path, metavar="FILE", help="write the hand samples and end")
    for f in fields(TrainConfig):
        if f.default is MISSING:
            continue
        name = "--" + f.name.replace("_", "-")
        if isinstance(f.default, bool):
            parser.add_argument(name, action=argparse.BooleanOptionalAction, default=f.default)
        else:
            parser.add_argument(name, type=type(f.default), default=f.default)
    options = parser.parse_args(arguments)
    try:
        if options.prepare_hands is not None:
            save_hands(options.prepare_hands)
            return 0
        if options.out is None:
            raise UserError("say where the weights go: --out DIR")
        column = column_of(options.estimator, options.column)
        config = TrainConfig(**{f.name: getattr(options, f.name) for f in fields(TrainConfig)})
        clouds = PROTOCOLS[options.protocol]()
        method: Ours | PaperMethod = Ours(clouds_config=clouds) if column is None else PaperMethod(column, clouds)
        train(options.out, config, method, options.hands, options.calibrate_only, options.init, options.rendered)
    except TooleeError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2 if isinstance(error, UserError) else 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
