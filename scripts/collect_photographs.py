"""Collect the development set of real RGB-D frames from checkouts of public repositories, which it does not contain.

    python scripts/collect_photographs.py CHECKOUTS --out data/photographs

CHECKOUTS holds one git repository per entry of docs/benchmark/photographs/sources.json, named OWNER+NAME (bare or
not). The result is a folder for `toolee evaluate photographs`: `frames.json`, colour and depth as PNG. Frames are
numbered in the order of their paths; odd ones are half A, even ones half B.
"""

from __future__ import annotations

import argparse
import fnmatch
import io
import json
import pickle
import struct
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import cv2
import numpy as np
import trimesh
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

SOURCES = Path(__file__).parents[1] / "docs" / "benchmark" / "photographs" / "sources.json"
_MILLIMETRES = 1000.0
_FARTHEST = 10.0
"""Depth of image pairs beyond which it counts as unknown [m]."""
_EE_RADIUS = 0.05
"""Radius of the sphere about a screwdriver's tip that is its end effector [m], as in the rendered data sets."""


@dataclass
class _Frame:
    """A frame of a set.

    Attributes:
        path: Path in the repository.
        rgb: Colour, (H, W, 3) uint8.
        depth: Depth (H, W) [m], 0 where unknown.
        intrinsics: fx, fy, cx, cy [px].
        ends: The annotated end effectors, as in `frames.json`.
        ignore: Boxes that do not count [px].
    """

    path: str
    rgb: NDArray[Any]
    depth: NDArray[Any]
    intrinsics: tuple[float, float, float, float]
    ends: list[dict[str, Any]]
    ignore: list[list[float]]


class _Checkout:
    """Files of one commit of a git repository."""

    def __init__(self, folder: Path, commit: str) -> None:
        self._git = ["git", f"--git-dir={folder / '.git' if (folder / '.git').is_dir() else folder}"]
        self._commit = commit

    def read(self, path: str) -> bytes:
        return subprocess.run([*self._git, "show", f"{self._commit}:{path}"], capture_output=True, check=True).stdout

    def paths(self, pattern: str) -> list[str]:
        listed = subprocess.run(
            [*self._git, "ls-tree", "-r", "--name-only", self._commit], capture_output=True, check=True, text=True
        )
        return sorted(fnmatch.filter(listed.stdout.splitlines(), pattern))

    def image(self, path: str) -> NDArray[Any]:
        image: Any = cv2.imdecode(np.frombuffer(self.read(path), np.uint8), cv2.IMREAD_UNCHANGED)
        return image[..., ::-1] if image.ndim == 3 else image


def _point_clouds(source: _Checkout, about: dict[str, Any]) -> Iterator[_Frame]:
    """Organised point clouds of the Point Cloud Library; the intrinsics are those that their points obey."""
    for pattern in about["paths"]:
        for path in source.paths(pattern):
            rgb, points = _read_pcd(source.read(path))
            height, width = rgb.shape[:2]
            if height == 1:  # some clouds of the set are not organised as images
                continue
            seen = np.isfinite(points).all(2) & (points[..., 2] > 0)
            z = points[..., 2][seen]
            place = np.indices((height, width))[:, seen]
            fx, cx = np.polyfit(points[..., 0][seen] / z, place[1], 1)
            fy, cy = np.polyfit(points[..., 1][seen] / z, place[0], 1)
            depth = np.where(seen, points[..., 2], 0)
            yield _Frame(path, rgb, depth, (float(fx), float(fy), float(cx), float(cy)), [], [])


def _numpy_records(source: _Checkout, about: dict[str, Any]) -> Iterator[_Frame]:
    """Pickled numpy records with colour, depth [m] and intrinsics; of the pickles only arrays are read."""
    for path in source.paths(about["paths"][0]):
        file = io.BytesIO(source.read(path))
        np.lib.format.read_magic(file)
        np.lib.format.read_array_header_1_0(file)
        record = _ArraysOnly(file, encoding="latin1").load().item()
        K, depth = record["intrinsics_matrix"], np.nan_to_num(record["depth"])
        yield _Frame(path, record["image"], depth, (K[0, 0], K[1, 1], K[0, 2], K[1, 2]), [], [])


def _image_pairs(source: _Checkout, about: dict[str, Any]) -> Iterator[_Frame]:
    """Colour images and depth images registered to them, in the same order or, where named by time, the nearest."""
    colours, depths = source.paths(about["paths"][0]), source.paths(about["depth"])
    if about.get("named_by_time"):
        times = np.array([float(PurePosixPath(p).stem) for p in depths])
        depths = [depths[np.abs(times - float(PurePosixPath(p).stem)).argmin()] for p in colours]
    for path, depth_path in list(zip(colours, depths, strict=True))[:: about.get("every", 1)]:
        depth = source.image(depth_path) / about["per_metre"]
        depth = _closed(np.where((depth > 0) & (depth < _FARTHEST), depth, np.inf), about.get("gaps", 1))
        yield _Frame(path, source.image(path), depth, tuple(about["intrinsics"]), [], [])


def _shelf_images(source: _Checkout, about: dict[str, Any]) -> Iterator[_Frame]:
    """Colour and depth of two cameras, with their calibration; the depth is projected into the colour image."""
    text = [v for v in source.read(about["calibration"]).decode().splitlines() if v and not v.startswith("#")]
    rows = [[float(x) for x in line.split()] for line in text[:10]]
    K_rgb, K_depth, X = np.array(rows[:3]), np.array(rows[3:6]), np.array(rows[6:10])
    for path in source.paths(about["paths"][0]):
        rgb, raw = source.image(path), source.image(path.replace(*about["depth"]))
        # The files hold tenths of a millimetre, rotated by three bits.
        z = ((raw >> 3) | (raw << 13)).astype(np.float64) / 10_000.0
        v, u = np.nonzero(z)
        rays = np.linalg.inv(K_depth) @ np.stack([u, v, np.ones_like(u)])
        points = X[:3, :3] @ (rays * z[v, u]) + X[:3, 3:]
        yield _Frame(path, rgb, _splatted(points, K_rgb, rgb.shape[:2]), _four(K_rgb), [], [])


def _digital_twin(source: _Checkout, about: dict[str, Any]) -> Iterator[_Frame]:
    """Photographs with calibrated poses of camera and tools; depth and masks are modelled from the tools' meshes."""
    config = yaml.safe_load(source.read(about["config"]))
    camera = config["cameras"]["camera_6"]
    K, distortion = np.array(camera["CameraIntrinsic"]).reshape(3, 3), np.array(camera["DistCoeffs"])
    X_flange_camera = np.array(camera["Tmatrix_Flange_Camera"]).reshape(4, 4)
    poses = np.loadtxt(io.StringIO(source.read(about["poses"]).decode()), delimiter=",")
    parts, owner = [], []
    for k, (name, path) in enumerate(about["meshes"].items()):
        mesh: Any = trimesh.load_mesh(io.BytesIO(source.read(path)), file_type="stl")
        mesh.apply_scale(0.001)
        parts.append(mesh.apply_transform(_placed(config, name)))
        owner += [k] * len(mesh.faces)
    cube = trimesh.creation.box([0.056] * 3, _placed(config, "Cube"))
    X_base_table = np.eye(4)
    X_base_table[:3, 3] = -0.5, 0.17, about["table"]
    table = trimesh.creation.box([2, 2, 0.002], X_base_table)
    scene: Any = trimesh.util.concatenate([*parts, cube, table])
    owners = np.array([*owner, *[len(parts)] * (len(cube.faces) + len(table.faces))])
    X_base_tool = _placed(config, "Screw_driver")
    tip, out = (X_base_tool @ [*about["tip"], 1])[:3], X_base_tool[:3, :3] @ about["axis"]
    for row, path in zip(poses, source.paths(about["paths"][0]), strict=True):
        X_base_camera = np.eye(4)
        X_base_camera[:3, :3], X_base_camera[:3, 3] = Rotation.from_quat(row[3:]).as_matrix(), row[:3]
        X_base_camera = X_base_camera @ X_flange_camera
        rgb = cv2.undistort(np.ascontiguousarray(source.image(path)), K, distortion)
        depth, points, seen_owner = _cast(scene, owners, X_base_camera, K, rgb.shape[:2])
        end = (seen_owner == 0) & (np.linalg.norm(points - tip, axis=2) < _EE_RADIUS)
        X = np.linalg.inv(X_base_camera)
        z = X[:3, :3] @ out
        side = np.cross(z, [0, 0, 1])
        side /= np.linalg.norm(side)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = np.stack([side, np.cross(z, side), z], 1), (X @ [*tip, 1])[:3]
        head = K @ (X @ [*_placed(config, "Rachet")[:3, 3], 1])[:3]
        # The ratchet, whose mesh the repository has not in a readable form, is left out of the model and of the score.
        u, v = head[:2] / head[2]
        ignore = [[float(u - 190), float(v - 190), float(u + 190), float(v + 190)]]
        ends = [{"category": "screwdriver_head", "box": _box(end), "X_camera_ee": pose.round(6).tolist()}]
        yield _Frame(path, rgb, depth, _four(K), ends if end.sum() >= 50 else [], ignore)


READERS = {f.__name__[1:]: f for f in (_point_clouds, _numpy_records, _image_pairs, _shelf_images, _digital_twin)}


class _ArraysOnly(pickle.Unpickler):
    """Unpickles arrays and plain values, and nothing that could run."""

    def find_class(self, module: str, name: str) -> Any:
        known = {"_reconstruct", "scalar", "ndarray", "dtype", "encode"}
        if module.split(".")[0] not in ("numpy", "_codecs") or name not in known:
            raise pickle.UnpicklingError(f"{module}.{name} is no array")
        return super().find_class(module.replace("numpy.core", "numpy._core"), name)


def _placed(config: dict[str, Any], name: str) -> NDArray[Any]:
    about = config[f"object_pose_{name}"]
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = Rotation.from_euler("xyz", about["rotation"]).as_matrix(), about["location"]
    return X


def _four(K: NDArray[Any]) -> tuple[float, float, float, float]:
    return float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])


def _box(mask: NDArray[Any]) -> list[float]:
    v, u = np.nonzero(mask)
    return [float(u.min()), float(v.min()), float(u.max() + 1), float(v.max() + 1)] if len(u) else [0.0] * 4


def _cast(
    scene: trimesh.Trimesh, owners: NDArray[Any], X: NDArray[Any], K: NDArray[Any], size: tuple[int, int]
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Depth [m], points in the base frame and the owner of each pixel's surface."""
    v, u = np.indices(size).reshape(2, -1)
    rays = np.linalg.inv(K) @ np.stack([u, v, np.ones_like(u)])
    directions = (X[:3, :3] @ rays).T
    hit, which, triangle = scene.ray.intersects_location(
        np.broadcast_to(X[:3, 3], directions.shape), directions, multiple_hits=False
    )
    depth, owner = np.zeros(len(u)), np.full(len(u), -1)
    points = np.full((len(u), 3), np.inf)
    depth[which] = (hit - X[:3, 3]) @ X[:3, 2]
    points[which], owner[which] = hit, owners[triangle]
    return depth.reshape(size), points.reshape(*size, 3), owner.reshape(size)


def _splatted(points: NDArray[Any], K: NDArray[Any], size: tuple[int, int]) -> NDArray[Any]:
    """Depth image (H, W) [m] of points (3, N) in the camera frame, the nearest one first, its gaps closed."""
    uv = K @ points
    u, v = np.rint(uv[0] / uv[2]).astype(int), np.rint(uv[1] / uv[2]).astype(int)
    inside = (u >= 0) & (u < size[1]) & (v >= 0) & (v < size[0])
    depth = np.full(size, np.inf)
    np.minimum.at(depth, (v[inside], u[inside]), points[2, inside])
    return _closed(depth, 3)


def _closed(depth: NDArray[Any], size: int) -> NDArray[Any]:
    """Depth image [m], 0 where unknown, of one that is infinite there: gaps narrower than `size` pixels are closed."""
    depth = np.where(np.isinf(depth), cv2.erode(depth, np.ones((size, size))), depth)
    return np.where(depth < 100, depth, 0)


def _read_pcd(data: bytes) -> tuple[NDArray[Any], NDArray[Any]]:
    """Colour (H, W, 3) and points (H, W, 3) [m] of an organised PCD file."""
    start = data.index(b"\n", data.index(b"\nDATA") + 1)
    lines = [v.split() for v in data[:start].decode().splitlines() if not v.startswith("#")]
    about = {v[0]: v[1:] for v in lines}
    names, n = about["FIELDS"], int(about["POINTS"][0])
    kinds = [f"<{t.lower()}{s}" for t, s in zip(about["TYPE"], about["SIZE"], strict=True)]
    counts = [int(c) for c in about.get("COUNT", ["1"] * len(names))]
    body = data[start + 1 :]
    columns: dict[str, NDArray[Any]] = {}
    if about["DATA"] == ["binary_compressed"]:
        packed, size = struct.unpack("<II", body[:8])
        body, place = _unpacked(body[8 : 8 + packed], size), 0
        for name, kind, count in zip(names, kinds, counts, strict=True):
            columns[name] = np.frombuffer(body, kind, n * count, place)
            place += columns[name].nbytes
    elif about["DATA"] == ["binary"]:
        fields = [
            (f"{k}{name}", kind, (c,)) for k, (name, kind, c) in enumerate(zip(names, kinds, counts, strict=True))
        ]
        table: Any = np.frombuffer(body, np.dtype(fields), n)
        columns = {name: table[f"{k}{name}"][:, 0] for k, name in enumerate(names)}
    else:
        table = np.array(body.split(), np.float64).reshape(n, -1)
        columns = {name: table[:, k].astype(kinds[k]) for k, name in enumerate(names)}
    size_hw = int(about["HEIGHT"][0]), int(about["WIDTH"][0])
    packed_rgb = np.ascontiguousarray(columns["rgb" if "rgb" in columns else "rgba"]).view(np.uint32)
    rgb = np.stack([(packed_rgb >> s) & 255 for s in (16, 8, 0)], 1).astype(np.uint8)
    points = np.stack([columns[k] for k in "xyz"], 1).astype(np.float64)
    return rgb.reshape(*size_hw, 3), points.reshape(*size_hw, 3)


def _unpacked(data: bytes, size: int) -> bytes:
    """Decode LZF, the compression of PCD files."""
    out, i = bytearray(), 0
    while i < len(data):
        control = data[i]
        i += 1
        if control < 32:
            out += data[i : i + control + 1]
            i += control + 1
            continue
        length = control >> 5
        if length == 7:
            length += data[i]
            i += 1
        begin = len(out) - ((control & 31) << 8) - data[i] - 1
        i += 1
        # A run may overlap what it copies: then the copied piece repeats.
        piece = out[begin : begin + length + 2]
        out += (piece * ((length + 2) // len(piece) + 1))[: length + 2]
    assert len(out) == size
    return bytes(out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("checkouts", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    index = []
    for about in json.loads(SOURCES.read_text())["sources"]:
        source = _Checkout(args.checkouts / about["repository"].replace("/", "+"), about["commit"])
        folder = args.out / about["place"]
        folder.mkdir(parents=True, exist_ok=True)
        for k, frame in enumerate(READERS[about["reader"]](source, about), 1):
            name = f"{about['place']}/{k:03d}"
            cv2.imwrite(str(args.out / f"{name}.png"), frame.rgb[..., ::-1])
            millimetres = np.rint(frame.depth * _MILLIMETRES).clip(0, 65535).astype(np.uint16)
            cv2.imwrite(str(args.out / f"{name}-depth.png"), millimetres)
            fields = {
                "name": name,
                "place": about["place"],
                "half": about.get("half", "AB"[(k + 1) % 2]),
                "path": frame.path,
            }
            fields |= {"rgb": f"{name}.png", "depth": f"{name}-depth.png", "depth_is": about["depth_is"]}
            fields |= {"intrinsics": [round(v, 3) for v in frame.intrinsics]}
            index.append({**fields, "ends": frame.ends, "ignore": frame.ignore})
        print(f"{about['place']}: {sum(f['place'] == about['place'] for f in index)} frames")
    (args.out / "frames.json").write_text(json.dumps({"frames": index}, indent=1) + "\n")


if __name__ == "__main__":
    main()
