"""The papers' equations in a few lines each, in float64, to hold the model of a preset against."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
import yaml
from scipy.special import factorial, lpmv

from pipeline.config.train_avatar import TrainAvatar

PRESETS = Path(__file__).parents[3] / "config/presets"
SLOPE, ROUNDING = 0.2, 2e-5
"""Of leaky ReLUs (RGCA supplement A); what float32 leaves of numbers of about 1 after some hundred operations."""


def section(name: str, stage: str) -> dict:
    """A stage's part of a preset, empty if it has none."""
    return yaml.safe_load((PRESETS / f"{name}.yaml").read_text()).get(stage, {})


def variants(name: str) -> dict[str, dict]:
    """Rows of a preset."""
    return section(name, "variants")


def preset(name: str, **sizes) -> TrainAvatar:
    """Settings of a preset, with other sizes of its networks."""
    return TrainAvatar(**section(name, "train_avatar") | sizes)


def shaken(avatar, strength=0.3):
    """The avatar with noise on every parameter, so that nothing is zero or alike."""
    torch.manual_seed(1)
    with torch.no_grad():
        for parameter in avatar.parameters():
            parameter += strength * torch.randn_like(parameter)
    return avatar


def numbers(tensor):
    """A tensor's values in float64."""
    return tensor.detach().double().numpy()


def assert_near(found, expected, rounding=ROUNDING):
    """Assert that a tensor has the expected values, which are not all zero, but for roundings of float32."""
    expected = np.asarray(expected)
    assert np.abs(numbers(found) - expected).max() <= rounding * max(1.0, np.abs(expected).max())
    assert np.abs(expected).max() > 0


def leaky(x):
    return torch.where(x > 0, x, SLOPE * x)


def dense(layer, x):
    return layer.weight.double() @ x + layer.bias.double()


def decoded(decoder, atlas, features):
    """Transposed 4 x 4 convolutions of stride 2 with untied biases, after leaky ReLUs; then the texels' values."""
    x = features[None]
    for layer in decoder.layers:
        x = torch.nn.functional.conv_transpose2d(leaky(x), layer.conv.weight.double(), stride=2, padding=1)
        x = x if layer.bias is None else x + layer.bias.double()
    place = torch.as_tensor((atlas.texel[:, ::-1] + 0.5) / atlas.size * 2 - 1)[None, None]
    at = torch.nn.functional.grid_sample(x, place, "bilinear", "border", align_corners=False)
    return at[0, :, 0].T


def rotations(quaternions):
    """Matrices of quaternions w x y z of any length."""
    w, x, y, z = (quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)).T
    return np.moveaxis(np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]), 2, 0)  # fmt: skip


def harmonics(directions, degrees=9):
    """Real spherical harmonics Y_lm [..., (n + 1)^2] of unit directions, in the order i = l^2 + l + m."""
    x, y, z = np.moveaxis(directions, -1, 0)
    around, found = np.arctan2(y, x), []
    for degree in range(degrees):
        for order in range(-degree, degree + 1):
            m = abs(order)
            size = (2 * degree + 1) / (4 * np.pi) * factorial(degree - m) / factorial(degree + m)
            turn = np.cos(m * around) if order >= 0 else np.sin(m * around)
            scale = np.sqrt((2 if m else 1) * size) * (-1) ** m  # Condon and Shortley's phase is in lpmv
            found.append(scale * turn * lpmv(m, degree, z))
    return np.stack(found, -1)


def lobe(p, q, sigma):
    """G(p; q, sigma) = 1 / (sqrt(2) pi^(2/3) sigma) exp(-(acos(p . q) / sigma)^2 / 2)."""
    angle = np.arccos(np.clip((p * q).sum(-1), -1, 1))
    return np.exp(-0.5 * (angle / sigma) ** 2) / (np.sqrt(2) * np.pi ** (2 / 3) * sigma)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def specular(points, normals, sigma, visibility, center, positions, intensities):
    """c_s = v sum_j I_j / d_j^2 G(w_j; q, sigma), q = 2 (w_o . n) n - w_o."""
    toward = unit(center - points)
    mirrored = 2 * (toward * normals).sum(-1, keepdims=True) * normals - toward
    out = np.zeros((len(points), 3))
    for position, intensity in zip(positions, intensities, strict=True):
        away = position - points
        distance2 = (away**2).sum(-1)
        out += (lobe(away / np.sqrt(distance2)[:, None], mirrored, sigma) / distance2)[:, None] * intensity
    return visibility[:, None] * out


def blended(gaussians, axes, values, camera, dilation_px2):
    """Sum over k of values_k alpha_k prod_{j < k} (1 - alpha_j), alpha, and the depth blended likewise.

    alpha_k is o_k times the Gaussian of Sigma' = J V Sigma V^T J^T plus the dilation. What 3DGS leaves out is left out:
    no alpha above 0.999 or below 1 / 255, and nothing once less than 1e-4 of the light would be left.
    """
    R, t, K = (tensor.double().numpy() for tensor in (camera.R, camera.t, camera.K))
    means, scales, opacities = (
        getattr(gaussians, name).detach().double().numpy() for name in ("means", "scales", "opacities")
    )
    seen = means @ R.T + t
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    values = np.concatenate([values, seen[:, 2:]], 1)
    picture, light = np.zeros((camera.height, camera.width, values.shape[1])), np.ones((camera.height, camera.width))
    going = light > 0
    for k in np.argsort(seen[:, 2], kind="stable"):
        x, y, z = seen[k]
        # As in 3DGS, the slope of the projection is taken no further outside than 0.3 of half the picture.
        half = np.array([0.5 * camera.width / K[0, 0], 0.5 * camera.height / K[1, 1]])
        middle = np.array([half[0] - K[0, 2] / K[0, 0], half[1] - K[1, 2] / K[1, 1]])
        u, v = np.clip([x / z, y / z], middle - 1.3 * half, middle + 1.3 * half)
        J = np.array([[K[0, 0] / z, 0, -K[0, 0] * u / z], [0, K[1, 1] / z, -K[1, 1] * v / z]])
        sigma = axes[k] @ np.diag(scales[k] ** 2) @ axes[k].T
        precision = np.linalg.inv(J @ R @ sigma @ R.T @ J.T + dilation_px2 * np.eye(2))
        away = np.stack([columns - K[0, 0] * x / z - K[0, 2], rows - K[1, 1] * y / z - K[1, 2]], -1)
        power = np.einsum("hwi,ij,hwj->hw", away, precision, away)
        alpha = np.minimum(0.999, opacities[k] * np.exp(-0.5 * power))
        alpha[alpha < 1 / 255] = 0
        going &= light * (1 - alpha) > 1e-4
        alpha = alpha * going
        picture += (light * alpha)[..., None] * values[k]
        light *= 1 - alpha
    return picture[..., :-1], 1 - light, picture[..., -1]


def bound(values, low, high):
    """mean(l): 1 / max(v, 1e-7) below `low`, (v - high)^2 above `high`, 0 between (RFGCA B.2, RGCA 14)."""
    terms = np.zeros_like(values)
    terms[values < low] = 1 / np.maximum(values[values < low], 1e-7)
    terms[values > high] = (values[values > high] - high) ** 2
    return terms.mean()


def points_of(row, column, depth, camera):
    """World points of pixels' centres at camera depths."""
    R, t, K = (tensor.double().numpy() for tensor in (camera.R, camera.t, camera.K))
    local = np.stack([(column + 0.5 - K[0, 2]) / K[0, 0], (row + 0.5 - K[1, 2]) / K[1, 1], np.ones(len(row))], -1)
    return (local * depth[:, None] - t) @ R
