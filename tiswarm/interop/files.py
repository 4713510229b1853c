"""Writes shapes as glTF (one binary file) and as PLY (a binary file each)."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiswarm.records.io import write_bytes

Z_UP = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]
"""Quaternion xyzw that turns our z into the y that is up in glTF."""

FLOAT, UINT = 5126, 5125
VERTICES, INDICES = 34962, 34963
LINES, TRIANGLES = 1, 4
TYPES = {1: "SCALAR", 3: "VEC3"}
MATTE = {"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.7}}


@dataclass(frozen=True, kw_only=True)
class Shape:
    """V points, joined to triangles or to lines."""

    name: str
    point: NDArray[np.float32]
    """Places [R], shape (V, 3)."""

    normal: NDArray[np.float32] | None
    """Which way is out at each point, of triangles alone, shape (V, 3)."""

    color: NDArray[np.float32]
    """Red, green, blue (sRGB) of each point, 0 to 1, shape (V, 3)."""

    index: NDArray[np.uint32]
    """Points of each triangle, shape (T, 3), or of each line, shape (L, 2)."""


def write_gltf(shapes: Sequence[Shape], path: Path) -> None:
    """Write every shape as a node of one `.glb`; lengths in R, y up as glTF has it."""
    buffer = _Buffer()
    meshes = [{"name": shape.name, "primitives": [_primitive(shape, buffer)]} for shape in shapes]
    children = list(range(1, len(shapes) + 1))
    document = {
        "asset": {"version": "2.0", "generator": "tiswarm", "extras": {"length_unit": "R"}},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [
            {"name": "z-up", "rotation": Z_UP, "children": children},
            *({"name": shape.name, "mesh": mesh} for mesh, shape in enumerate(shapes)),
        ],
        "meshes": meshes,
        "materials": [MATTE],
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.data)}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = _chunk(b"JSON", text) + _chunk(b"BIN\0", bytes(buffer.data))
    write_bytes(path, b"glTF" + _uint(2, 12 + len(chunks)) + chunks)


def write_ply(shape: Shape, path: Path) -> None:
    """Write one shape; triangles become faces, lines become edges."""
    columns = [("x", "y", "z"), ("nx", "ny", "nz")][: 1 if shape.normal is None else 2]
    fields = [(name, "<f4") for group in columns for name in group]
    fields += [(name, "u1") for name in ("red", "green", "blue")]
    vertex = np.empty(len(shape.point), fields)
    parts = [shape.point, *([] if shape.normal is None else [shape.normal])]
    parts.append(np.round(255.0 * shape.color).astype(np.uint8))
    for (name, _), column in zip(fields, np.concatenate([p.T for p in parts]), strict=True):
        vertex[name] = column
    if shape.index.shape[1] == LINES + 1:
        element = np.empty(len(shape.index), [("vertex1", "<i4"), ("vertex2", "<i4")])
        element["vertex1"], element["vertex2"] = shape.index.T
        kind = ["element edge", "property int vertex1", "property int vertex2"]
    else:
        element = np.empty(len(shape.index), [("count", "u1"), ("point", "<i4", 3)])
        element["count"], element["point"] = 3, shape.index
        kind = ["element face", "property list uchar int vertex_indices"]
    types = {"<f4": "float", "u1": "uchar"}
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment tiswarm {shape.name}, lengths in R",
        f"element vertex {len(vertex)}",
        *(f"property {types[kind]} {name}" for name, kind in fields),
        f"{kind[0]} {len(element)}",
        *kind[1:],
        "end_header\n",
    ]
    write_bytes(path, "\n".join(header).encode() + vertex.tobytes() + element.tobytes())


class _Buffer:
    """The numbers of a glTF file, and where in it each array is."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, int]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, array: NDArray[np.float32] | NDArray[np.uint32], target: int) -> int:
        """Append an array; returns its number."""
        data = np.ascontiguousarray(array).tobytes()
        self.views.append(
            {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), "target": target}
        )
        self.data += data
        width = array.shape[1] if array.ndim > 1 else 1
        accessor = {
            "bufferView": len(self.views) - 1,
            "componentType": FLOAT if array.dtype == np.float32 else UINT,
            "count": len(array),
            "type": TYPES[width],
        }
        if target == VERTICES:
            accessor |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def _primitive(shape: Shape, buffer: _Buffer) -> dict[str, Any]:
    """Put a shape's arrays into the buffer, and say how to draw them."""
    attributes = {"POSITION": buffer.add(shape.point, VERTICES)}
    if shape.normal is not None:
        attributes["NORMAL"] = buffer.add(shape.normal, VERTICES)
    linear = (shape.color**2.2).astype(np.float32)
    attributes["COLOR_0"] = buffer.add(linear, VERTICES)
    return {
        "attributes": attributes,
        "indices": buffer.add(shape.index.ravel(), INDICES),
        "material": 0,
        "mode": LINES if shape.index.shape[1] == LINES + 1 else TRIANGLES,
    }


def _chunk(kind: bytes, data: bytes) -> bytes:
    return _uint(len(data)) + kind + data


def _uint(*numbers: int) -> bytes:
    return np.array(numbers, "<u4").tobytes()
