"""Training clouds of the paper's own protocol, for `toolee train paper`.

python -m benchmarks.published_clouds FILE [--images 750] [--seed 0] [--whole-tools] [--workers 2]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from toolee_robot.perception.offline.published import published_clouds


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Training clouds of the paper's own protocol.")
    parser.add_argument("out", type=Path, metavar="FILE")
    parser.add_argument("--images", type=int, default=750, help="of each of the 42 tools")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--whole-tools", action="store_true", help="for the column object-prior")
    parser.add_argument("--workers", type=int, default=1)
    asked = parser.parse_args(arguments)
    clouds = published_clouds(asked.images, asked.seed, whole_tools=asked.whole_tools, workers=asked.workers)
    clouds.save(asked.out)
    print(f"{len(clouds)} clouds in {asked.out}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
