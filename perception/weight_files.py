"""Weights on disk: safetensors shards under 16 MiB each, in half precision, with a JSON file beside them.

`NAME-00001-of-00002.safetensors`, `NAME-00002-of-00002.safetensors` and `NAME.json` (architecture, training
configuration, log), with checksums in `sha256.txt`: those of the weights are checked, a description may be edited.
Nothing is ever fetched from a network.
"""

from __future__ import annotations

import hashlib
import json
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from safetensors.torch import save as serialised

from toolee_robot.errors import AssetError, words_of
from toolee_robot.runtime.files import read_json, read_text, sha256, write_atomic, written_whole
from toolee_robot.runtime.processes import interrupts_held

WEIGHTS_DIR = Path(__file__).resolve().parent / "weights"
"""Folder of the shipped weights."""
SUMS = "sha256.txt"
"""The file of checksums, as `sha256sum` writes and checks it."""
SHARD_BYTES = 15 * 1024 * 1024
"""Largest shard [byte]: small files are easier to store, review and transfer."""


def save_weights(directory: Path, name: str, tensors: dict[str, torch.Tensor], description: dict[str, Any]) -> None:
    """Write weights and their description; older shards of the same name are removed.

    Args:
        directory: Output folder.
        name: Name of the files.
        tensors: The weights; floating ones are written in half precision.
        description: Written as JSON.

    Raises:
        AssetError: A tensor is not finite in half precision.
    """
    half = {key: _half(key, value) for key, value in tensors.items()}
    shards: list[dict[str, torch.Tensor]] = [{}]
    size = 0
    for key, value in half.items():
        n = value.numel() * value.element_size()
        if size + n > SHARD_BYTES and shards[-1]:
            shards.append({})
            size = 0
        shards[-1][key] = value
        size += n
    directory.mkdir(parents=True, exist_ok=True)
    files = [directory / f"{name}-{i + 1:05d}-of-{len(shards):05d}.safetensors" for i in range(len(shards))]
    with interrupts_held():
        with ExitStack() as whole:  # the old ones stay until all of the new ones are on the disk
            for shard, file in zip(shards, files, strict=True):
                # By Python: where the disk is full the library's own error has no file and no remedy.
                whole.enter_context(written_whole(file)).write_bytes(serialised(shard))
        for old in set(directory.glob(f"{name}-*-of-*.safetensors")) - set(files):
            old.unlink()
        files.append(directory / f"{name}.json")
        write_atomic(files[-1], (json.dumps(description, indent=1) + "\n").encode())
        _write_sums(directory, name, files)


def _write_sums(directory: Path, name: str, files: list[Path]) -> None:
    own = (f"{name}-", f"{name}.")  # of this name before
    others = {file: digest for file, digest in _sums(directory).items() if not file.startswith(own)}
    sums = others | {file.name: sha256(file) for file in files}
    write_atomic(directory / SUMS, "".join(f"{digest}  {file}\n" for file, digest in sums.items()).encode())


def load_weights(directory: Path | None, name: str) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    """Read weights and their description.

    Args:
        directory: Folder of weights; None: the shipped ones.
        name: Name of the files.

    Returns:
        Tensors (floating ones as float32) and description.

    Raises:
        AssetError: A file is missing, unreadable or damaged; the message names it.
    """
    directory = WEIGHTS_DIR if directory is None else directory
    path, sums = directory / f"{name}.json", _sums(directory)
    try:
        description = read_json(path)
    except OSError as error:
        raise AssetError(
            f"weight description {path} is missing: reinstall the package, or train with "
            f"`toolee train {name}` and pass its output folder",
            code="asset.missing",
        ) from error
    except ValueError as error:
        raise AssetError(
            f"weight description {path} is not valid JSON: fetch the file again ({error})", code="asset.unreadable"
        ) from error
    shards = sorted(directory.glob(f"{name}-*-of-*.safetensors"))
    count = int(shards[0].stem.rsplit("-of-", 1)[1]) if shards else 1
    tensors: dict[str, torch.Tensor] = {}
    for i in range(count):
        shard = directory / f"{name}-{i + 1:05d}-of-{count:05d}.safetensors"
        if not shard.is_file():
            raise AssetError(
                f"weight file {shard} is missing: reinstall the package or fetch the file again", code="asset.missing"
            )
        try:
            _check(shard, sums)
            tensors.update(load_file(shard))
        except (SafetensorError, OSError) as error:
            raise AssetError(
                f"weight file {shard} is unreadable: fetch the file again ({words_of(error)})", code="asset.unreadable"
            ) from error
    if wrong := [key for key, value in tensors.items() if value.is_floating_point() and not value.isfinite().all()]:
        message = f"the weights {name} in {directory} are not finite ({wrong[0]}): fetch the files again"
        raise AssetError(message)
    return {key: value.float() if value.is_floating_point() else value for key, value in tensors.items()}, description


def _sums(directory: Path) -> dict[str, str]:
    """Checksums by file; none in a folder that has no list of them."""
    path = directory / SUMS
    try:
        return {line[66:]: line[:64] for line in read_text(path).splitlines()} if path.exists() else {}
    except (OSError, ValueError) as error:
        message = f"{path} is unreadable ({words_of(error)}): fetch it again"
        raise AssetError(message, code="asset.unreadable") from error


def _check(path: Path, sums: dict[str, str]) -> None:
    if sums and sha256(path) != sums.get(path.name):
        message = f"weight file {path} is damaged: its checksum is not the one in {SUMS}. Fetch both again"
        raise AssetError(message, code="asset.unreadable")


def load_into(network: torch.nn.Module, tensors: dict[str, torch.Tensor], what: str) -> None:
    """Load weights into a network.

    Args:
        network: The network, changed in place.
        tensors: The weights.
        what: Name of the network in messages.

    Raises:
        AssetError: The weights do not fit the network.
    """
    try:
        missing, unexpected = network.load_state_dict(tensors, strict=False)
    except RuntimeError as error:
        raise AssetError(
            f"the {what}'s weights do not fit its architecture, fetch them again: {error}", code="asset.architecture"
        ) from error
    missing = [name for name in missing if not name.endswith("num_batches_tracked")]
    if missing or unexpected:
        raise AssetError(
            f"the {what}'s weights are incomplete, fetch them again: {(missing + unexpected)[:5]}",
            code="asset.incomplete",
        )


def weights_hash(folder: Path) -> str:
    """What identifies the weights in a folder.

    Args:
        folder: The folder.

    Returns:
        SHA-256 of the names and contents of the weights and their descriptions.
    """
    digest = hashlib.sha256()
    for path in sorted(p for p in folder.iterdir() if p.suffix in (".safetensors", ".json")):
        digest.update(f"{sha256(path)}  {path.name}\n".encode())
    return digest.hexdigest()


def _half(name: str, value: torch.Tensor) -> torch.Tensor:
    value = value.detach().cpu().contiguous()
    if not value.is_floating_point():
        return value
    half = value.half()
    if not torch.isfinite(half).all():
        raise AssetError(f"weight {name} is not finite in half precision: the training run diverged")
    return half
