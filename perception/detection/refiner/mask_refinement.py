"""Mask refinement: the refiner applied to the detections of one image."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from toolee_robot.errors import AssetError
from toolee_robot.perception.detection.detector import TOOL
from toolee_robot.perception.detection.instances import Instances, without_duplicates
from toolee_robot.perception.detection.mask_head import paste_one
from toolee_robot.perception.detection.refiner.crops import Images, Squares, sample_squares
from toolee_robot.perception.detection.refiner.network import WEIGHTS_NAME, Refiner, RefinerConfig, load_refiner
from toolee_robot.perception.precision import in_bfloat16
from toolee_robot.perception.weight_files import WEIGHTS_DIR, load_weights
from toolee_robot.types import RgbdFrame


class MaskRefinement:
    """A trained refiner, ready for inference. Thread-safe once loaded.

    Args:
        refiner: The trained network; its batch normalisation is fused in place.
        device: torch device that runs it.
        bfloat16: Whether a CPU computes in bfloat16.
    """

    def __init__(self, refiner: Refiner, device: torch.device, bfloat16: bool) -> None:
        self._device, self._bfloat16 = device, bfloat16
        self._refiner = refiner.fuse().to(device).to(memory_format=torch.channels_last)
        if bfloat16:
            in_bfloat16(self._refiner)

    @classmethod
    def load(cls, weights_dir: Path | None, device: torch.device, bfloat16: bool) -> MaskRefinement | None:
        """Load the refiner beside a detector's weights.

        Args:
            weights_dir: Folder of weights; None: the shipped ones.
            device: torch device that runs it.
            bfloat16: Whether a CPU computes in bfloat16.

        Returns:
            The refiner; None where the folder has none.

        Raises:
            AssetError: A file is unreadable or damaged; the message names it.
        """
        if not ((weights_dir or WEIGHTS_DIR) / f"{WEIGHTS_NAME}.json").is_file():
            return None
        tensors, description = load_weights(weights_dir, WEIGHTS_NAME)
        try:
            refiner = Refiner(RefinerConfig.from_json(description["model"]))
        except (KeyError, TypeError, ValueError) as error:
            raise AssetError(
                f"the refiner's description is damaged, fetch it again: {error!r}", code="asset.unreadable"
            ) from error
        load_refiner(refiner, tensors)
        return cls(refiner, device, bfloat16)

    @torch.inference_mode()
    def __call__(self, frame: RgbdFrame, instances: Instances) -> Instances:
        """Refine the masks of end effectors.

        Args:
            frame: The frame.
            instances: The detector's instances in it.

        Returns:
            The instances, best score first, duplicates removed; EEs with new masks and with the geometric mean of the
            detector's score and the refiner's predicted IoU.
        """
        masks, labels, scores, boxes = instances
        ees = [i for i, label in enumerate(labels) if label != TOOL]
        if not ees:
            return instances
        d = self._device
        squares = Squares.about(torch.tensor([boxes[i] for i in ees], dtype=torch.float32, device=d))
        logits, quality = self._outputs(
            frame,
            torch.from_numpy(np.stack([masks[i] for i in ees])).to(d),
            squares,
            torch.tensor([labels[i] - 1 for i in ees], device=d),
            torch.tensor([scores[i] for i in ees], dtype=torch.float32, device=d),
        )
        probability, covered = logits.sigmoid().cpu().numpy(), squares.boxes().cpu().numpy().astype(np.float64)
        masks, scores = list(masks), list(scores)
        for i, patch, box, good in zip(ees, probability, covered, quality.sigmoid().tolist(), strict=True):
            drawn = paste_one(patch, box, *frame.depth.shape)
            masks[i] = drawn if drawn.any() else masks[i]
            scores[i] = float(np.sqrt(scores[i] * good))
        return without_duplicates(masks, labels, scores, boxes)

    def _outputs(
        self, frame: RgbdFrame, masks: torch.Tensor, squares: Squares, category: torch.Tensor, score: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Mask logits and quality logits: the means over each square and its mirror image."""
        d = self._device
        K = frame.intrinsics
        depth = np.nan_to_num(frame.depth, nan=0.0, posinf=0.0, neginf=0.0).astype(np.float32)
        images = Images(
            torch.from_numpy(np.ascontiguousarray(frame.rgb)).to(d)[None],
            torch.from_numpy(depth).to(d)[None],
            torch.tensor([float(np.sqrt(K.fx * K.fy))], dtype=torch.float32, device=d),
        )
        first = torch.zeros(len(masks), dtype=torch.long, device=d)
        which = torch.arange(len(masks), device=d)[:, None, None]
        both = [
            sample_squares(images, first, s, lambda u, v: masks[which, v, u])[0]
            for s in (squares, squares.mirrored_copy())
        ]
        seen = torch.cat(both).contiguous(memory_format=torch.channels_last)
        with torch.autocast(d.type, torch.bfloat16, enabled=self._bfloat16):
            logits, quality = self._refiner(seen, category.repeat(2), score.repeat(2))
        logits, again = logits.float().chunk(2)
        return (logits + again.flip(2)) / 2, quality.float().view(2, -1).mean(0)
