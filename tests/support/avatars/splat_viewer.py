"""A splat viewer in NumPy, after Kerbl et al. 2023 and the reference implementation's file.

As an independent second look it shares no code with the project. It reads the .ply with its own parser, undoes the
activations, and draws every Gaussian over the picture from back to front, with the dilation of 0.3 px^2 that viewers
have.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

SH_C0 = 0.28209479177387814
VIEWERS_DILATION_PX2 = 0.3


def read_columns(path: Path) -> dict[str, np.ndarray]:
    """Columns of the vertex element by name, as the header orders them."""
    with path.open("rb") as file:
        names, count = [], 0
        while (line := file.readline().decode().split()) != ["end_header"]:
            if line[:2] == ["element", "vertex"]:
                count = int(line[2])
            elif line[0] == "property":
                assert line[1] == "float"
                names.append(line[2])
        rows = np.frombuffer(file.read(), "<f4").reshape(count, len(names)).astype(np.float64)
    return dict(zip(names, rows.T, strict=True))


def rotation_matrices(w, x, y, z):
    return np.moveaxis(
        np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]), 2, 0,
    )  # fmt: skip


def view(path: Path, camera) -> tuple[np.ndarray, np.ndarray]:
    """The picture as a screen shows it, [h, w, 3] over black, and alpha [h, w]."""
    column = read_columns(path)
    means = np.stack([column[name] for name in "xyz"], 1) @ camera.R.T + camera.t
    quaternions = np.stack([column[f"rot_{k}"] for k in range(4)])
    turns = rotation_matrices(*quaternions / np.linalg.norm(quaternions, axis=0))
    scales = np.exp(np.stack([column[f"scale_{k}"] for k in range(3)], 1))
    opacities = 1 / (1 + np.exp(-column["opacity"]))
    colors = np.clip(SH_C0 * np.stack([column[f"f_dc_{k}"] for k in range(3)], 1) + 0.5, 0, None)
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    picture, light = np.zeros((camera.height, camera.width, 3)), np.ones((camera.height, camera.width))
    fx, fy = camera.K[0, 0], camera.K[1, 1]
    for g in np.argsort(-means[:, 2], kind="stable"):
        x, y, z = means[g]
        if z < 0.2:
            continue
        J = np.array([[fx / z, 0, -fx * x / z**2], [0, fy / z, -fy * y / z**2]])
        shape = J @ camera.R @ turns[g] * scales[g]
        precision = np.linalg.inv(shape @ shape.T + VIEWERS_DILATION_PX2 * np.eye(2))
        dx, dy = columns - fx * x / z - camera.K[0, 2], rows - fy * y / z - camera.K[1, 2]
        q = precision[0, 0] * dx**2 + 2 * precision[0, 1] * dx * dy + precision[1, 1] * dy**2
        alpha = np.minimum(0.99, opacities[g] * np.exp(-0.5 * q))
        alpha[alpha < 1 / 255] = 0
        picture = alpha[..., None] * colors[g] + (1 - alpha)[..., None] * picture
        light *= 1 - alpha
    return picture, 1 - light
