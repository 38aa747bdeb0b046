"""Training of the pose network on clouds made as they are needed; see `toolee_robot.perception.train_pose`."""

from __future__ import annotations

import copy
import json
import math
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Generic

import torch
from torch import Tensor, nn

from toolee_robot.errors import AssetError, TooleeError, UserError
from toolee_robot.files import written_whole
from toolee_robot.perception.pose import validation
from toolee_robot.perception.pose.bank import Float32, ToolBank, load_hands, tool_bank
from toolee_robot.perception.pose.cloud_batch import CloudBatch
from toolee_robot.perception.pose.cloud_source import CloudSource, Mixture
from toolee_robot.perception.pose.method import Method, Net, Ours
from toolee_robot.perception.pose.rendered import RenderedClouds
from toolee_robot.perception.pose.reservoir import Reservoir
from toolee_robot.perception.pose.settled_norms import settle_norms
from toolee_robot.perception.pose.train_config import TrainConfig
from toolee_robot.perception.pose.weights import Calibration
from toolee_robot.perception.ranks import Ranks, ranks
from toolee_robot.perception.training_log import Scalars


class Trainer(Generic[Net]):
    """One network, one time budget; one device or, as one of several `Ranks`, several. `run` may be called again in a
    new process: it resumes."""

    def __init__(
        self,
        out: Path,
        config: TrainConfig,
        banks: tuple[ToolBank, ToolBank],
        hands: Float32,
        method: Method[Net],
        place: Ranks,
        rendered: RenderedClouds | None = None,
    ) -> None:
        """banks: training and held-out tools. rendered: clouds to mix in. The first rank validates, logs and writes."""
        self.out, self.config, self.ranks = out, config, place
        self.device = place.device
        torch.manual_seed(config.seed)
        self.method = method
        self.steps, self.elapsed = 0, 0.0
        self.net = method.network(banks[0]).to(self.device)
        self.ema = copy.deepcopy(self.net).requires_grad_(False)
        self._init: dict[str, Tensor] = {}
        self.optimizer = torch.optim.AdamW(
            self.net.parameters(),
            config.learning_rate,
            weight_decay=config.weight_decay,
            betas=(0.9, 0.99),
            fused=self.device.type == "cuda",
        )
        self._generator: CloudSource = method.clouds(banks[0], hands, self.device, self._seed(1))
        self._rendered = 0 if rendered is None else len(rendered)
        if rendered is not None:
            kept = method.kept(rendered, self.device, self._seed(3))
            self._generator = Mixture(self._generator, kept, config.rendered_share)
        self._test_bank = banks[1]
        self._held_out = method.clouds(banks[1], hands, self.device, 10_000 + config.seed)
        self._g = torch.Generator(self.device).manual_seed(self._seed(2))
        self._scalars = Scalars(out)
        out.mkdir(parents=True, exist_ok=True)

    def log(self, **record: Any) -> None:
        """One JSON line on the terminal and in log.jsonl."""
        if not self.ranks.first:
            return
        line = json.dumps({"step": self.steps, "minutes": round(self.elapsed / 60, 2), **record})
        print(line, flush=True)
        with (self.out / "log.jsonl").open("a") as file:
            file.write(line + "\n")
        self._scalars.add(self.steps, record)

    def run(self) -> dict[str, Any]:
        """Train until the time is used up, then validate, calibrate and write the weights. Returns the report (of ranks
        but the first an empty one)."""
        c = self.config
        self._resume()
        forward: nn.Module = self.net
        if c.compile and self.device.type == "cuda":
            forward = self._compiled()
        forward = self.ranks.shared(forward)
        reservoir = Reservoir(self._generator.collect(max(c.first_fill, c.batch), c.chunk), c.capacity)
        held_out = self.judged() if self.ranks.first else None
        size = sum(p.numel() for p in self.net.parameters())
        self.log(event="start", device=self.ranks.device_name, parameters=size, rendered_clouds=self._rendered)
        before, begun = self.elapsed, time.monotonic()
        base, last_save, last_log, logged_steps = reservoir.made, begun, begun, self.steps
        start_steps = self.steps
        end = before + 60 * c.session_minutes if c.session_minutes > 0 else math.inf
        while self._progress() < 1 and self.elapsed < end:
            while reservoir.made - base < (self.steps - start_steps) * c.batch / c.reuse:
                reservoir.add(self._generator.generate(c.chunk))
            settle_norms(self.net, self._progress() >= c.settle)
            batch = self.method.prepare(reservoir.draw(c.batch, self._g), self._g)
            rate = self._learning_rate()
            for group in self.optimizer.param_groups:
                group["lr"] = rate
            loss, parts = self.method.loss(forward, batch, self._g)
            self.optimizer.zero_grad(set_to_none=True)
            loss.backward()  # type: ignore[no-untyped-call]
            norm = nn.utils.clip_grad_norm_(self.net.parameters(), c.clip)
            # On a GPU each look waits for it: look now and then, and before anything is written.
            save = time.monotonic() - last_save > c.checkpoint_seconds
            look = self.device.type == "cpu" or self.steps % 20 == 0 or save
            if look and not bool(torch.isfinite(loss + norm)):
                raise TooleeError(
                    f"the loss is not finite at step {self.steps}: {_numbers(parts)}; nothing was overwritten"
                )
            self.optimizer.step()
            self.steps += 1
            self._average()
            now = time.monotonic()
            # The ranks must end with the same step, and none waits for another's clock at every one.
            if self.ranks.world == 1 or self.steps % 20 == 0:
                self.elapsed = self.ranks.agreed(before + now - begun)
            if now - last_log > 15:
                per_step = (now - last_log) / max(self.steps - logged_steps, 1)
                self.log(**_numbers(parts), lr=rate, ms_per_step=round(1e3 * per_step, 2), clouds=reservoir.made)
                last_log, logged_steps = now, self.steps
            if save:
                last_save = now
                self._checkpoint(held_out)
        # The checkpoint first: should the validation not get the time, the training is not lost.
        self._checkpoint(None)
        return self.finish(held_out) if held_out is not None else {}

    def start_from(self, weights: Path) -> None:
        """Begin with the network in `weights` instead of a random one. Raises AssetError where it does not fit."""
        state = self.method.load(weights).state_dict()
        try:
            self.net.load_state_dict(state)
            self.ema.load_state_dict(state)
            self._init = {name: value.to(self.device) for name, value in state.items()}
        except RuntimeError as error:
            raise AssetError(f"{weights} holds a network of another architecture: {error}") from error
        self.log(event="begun from other weights")

    def calibrate(self) -> dict[str, Any]:
        """Validate and calibrate the weights that lie in `out`, on any machine: what a training that ran out of time
        left undone. Returns the report."""
        self.ema.load_state_dict(self.method.load(self.out).state_dict())
        self._init = {}  # these are in the weights already
        described = json.loads((self.out / f"{self.method.name}.json").read_text())["report"]
        self.steps, self.elapsed = int(described["steps"]), 60.0 * float(described["minutes"])
        return self.finish(self.judged(), described["train"])

    def finish(self, held_out: CloudBatch, trained: dict[str, Any] | None = None) -> dict[str, Any]:
        """Validate and calibrate on held-out tools, and save. trained: the training's own configuration, if another."""
        report, calibration = self.method.report(self.export(), held_out, self._test_bank, str(self.device))
        self.log(event="finished", **{k: v for k, v in report.items() if k != "clouds"})
        report |= {
            "calibrated": True,
            "steps": self.steps,
            "minutes": round(self.elapsed / 60, 2),
            "train": trained or self._described(),
        }
        self.method.save(self.out, self.export(), calibration, report)
        return report

    def judged(self) -> CloudBatch:
        """The next held-out clouds."""
        return self.method.judged(self._held_out.collect(self.config.validation, self.config.chunk), self._test_bank)

    def _described(self) -> dict[str, Any]:
        """What the network was trained with, kept beside its weights."""
        return {**asdict(self.config), "rendered_clouds": self._rendered}

    def _progress(self) -> float:
        """How much of the budget is used, 1 at its end."""
        c = self.config
        return self.steps / c.max_steps if c.max_steps else self.elapsed / (60 * c.minutes)

    def export(self) -> Net:
        """The averaged network, with its share of the weights it started from, as it will be loaded: rounded to half
        precision."""
        net = copy.deepcopy(self.ema)
        for name, value in net.state_dict().items():
            if value.is_floating_point():
                value.lerp_(self._init.get(name, value), self.config.init_share)
                value.copy_(value.half().float())
        return net.eval()

    def _learning_rate(self) -> float:
        c = self.config
        cosine = 0.5 * (1 + math.cos(math.pi * min(self._progress(), 1.0)))
        return c.learning_rate * min((self.steps + 1) / c.warm_up, 1.0) * max(cosine, 1e-3)

    @torch.no_grad()
    def _average(self) -> None:
        decay = min(self.config.ema, (1 + self.steps) / (10 + self.steps))
        torch._foreach_lerp_(list(self.ema.parameters()), list(self.net.parameters()), 1 - decay)
        for kept, new in zip(self.ema.buffers(), self.net.buffers(), strict=True):
            kept.copy_(new)

    def _compiled(self) -> nn.Module:
        """The network compiled, or as it is where the compiler does not work."""
        compiled: nn.Module = torch.compile(self.net)  # type: ignore[assignment]
        batch = self._generator.collect(self.config.batch, self.config.chunk)
        try:
            for settled in (True, False):  # each is compiled for itself
                settle_norms(self.net, settled)
                self.method.loss(compiled, batch, self._g)[0].backward()  # type: ignore[no-untyped-call]
        except Exception as error:  # noqa: BLE001 - the compiler's errors have no common root; eager always works
            self.log(event="not compiled", error=f"{type(error).__name__}: {error}"[:300])
            torch._dynamo.reset()
            compiled = self.net
        self.net.zero_grad(set_to_none=True)
        return compiled

    def _seed(self, which: int) -> int:
        """Every rank has clouds, and so on, of its own; after a resumption, new ones."""
        return self.config.seed + which + 1_000_003 * self.ranks.rank + self.steps

    def _checkpoint(self, held_out: CloudBatch | None) -> None:
        if not self.ranks.first:
            return
        state = {
            "net": self.net.state_dict(),
            "ema": self.ema.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "steps": self.steps,
            "elapsed": self.elapsed,
        }
        with written_whole(self.out / "checkpoint.pt") as scratch:
            torch.save(state, scratch)
        self.method.save(
            self.out,
            self.export(),
            Calibration(),
            {
                "calibrated": False,
                "steps": self.steps,
                "minutes": round(self.elapsed / 60, 2),
                "train": self._described(),
            },
        )
        if held_out is not None:
            few = held_out.select(torch.arange(min(512, len(held_out)), device=self.device))
            estimator = self.method.estimator(self.export(), Calibration(), str(self.device))
            self.log(event="validation", **validation.metrics(validation.evaluate(estimator, few, 20)))

    def _resume(self) -> None:
        path = self.out / "checkpoint.pt"
        if not path.is_file():
            return
        state = torch.load(path, map_location=self.device, weights_only=True)
        self.net.load_state_dict(state["net"])
        self.ema.load_state_dict(state["ema"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.steps, self.elapsed = int(state["steps"]), float(state["elapsed"])
        self._generator.reseed(self._seed(1))
        self._g.manual_seed(self._seed(2))
        self.log(event="resumed")


def train(
    out: Path,
    config: TrainConfig,
    method: Method[Any] | None = None,
    hands_file: Path | None = None,
    calibrate_only: bool = False,
    init: Path | None = None,
    rendered: Sequence[Path] = (),
) -> dict[str, Any]:
    """Surface samples, training, validation, weights in `out`. Raises AssetError, UserError, TooleeError.

    method: `Ours` if None. calibrate_only: no training, but validation and calibration of the weights that are there.
    init: folder of weights to start from, of the same architecture; their process may be another. rendered: files of
    `RenderedClouds` to mix in.
    """
    method = method or Ours()
    if config.init_share and init is None and not calibrate_only:
        raise UserError("--init-share: say whose share that is, with --init FOLDER")
    kept = None
    if rendered:
        kept = RenderedClouds.cat([RenderedClouds.load(path) for path in rendered])
        kept.check_kind(method.of_tool)  # before the work
    begun = time.monotonic()
    banks = tool_bank(False, config.train_seeds), tool_bank(True, config.test_seeds)
    hands = load_hands(hands_file)
    print(f"{[len(b.category) for b in banks]} EEs and {len(hands)} hands sampled in {time.monotonic() - begun:.0f} s")
    with ranks() as place:
        trainer = Trainer(out, config, banks, hands, method, place, kept)
        if init is not None:
            trainer.start_from(init)
        return trainer.calibrate() if calibrate_only else trainer.run()


def _numbers(parts: dict[str, Tensor]) -> dict[str, float]:
    return {k: round(float(v), 4) for k, v in parts.items()}
