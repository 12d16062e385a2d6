"""Kernels give the same bits whether they have just been compiled or come from numba's cache.

Those that sum over lights, forward and backward, in parallel and with reordered sums: their bits depend on how they
were compiled. A process imports them and forks two children, one after the other: the first compiles, the second reads
what it wrote.
"""

import os
import subprocess
import sys

SCRIPT = """
import hashlib
import os
import numpy as np
import torch
from pipeline.lighting.irradiance import Samples, trace_irradiance
from pipeline.lighting.light_scene import Lights
from pipeline.lighting.matte import arriving_vectors
from pipeline.lighting.point_lights import PointLights
from pipeline.lighting.standard_error import TexelBlocks
from pipeline.lighting.visibility import Occluders
from pipeline.lighting.zonal import gather_light

def single_rays(points, lights):
    faces = np.arange(len(points)).reshape(-1, 3)
    a, b, c = points[faces].swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    blocks = TexelBlocks(np.stack(np.divmod(np.arange(len(faces)), 10), 1))
    drawn = Samples(1, "power", "low_discrepancy", blocks, np.random.default_rng(0))
    lit = Lights(lights, np.ones(len(lights)))
    found = trace_irradiance(Occluders(points, faces), (a + b + c) / 3, normals, lit, samples=drawn)
    assert 0 < found.values.mean() < 1
    return np.stack([found.values, found.cosine_visibility, found.error])

def run():
    generator = torch.Generator().manual_seed(0)
    def random(*shape):
        return torch.randn(*shape, generator=generator)
    points, axes = 0.4 * random(300, 3), torch.linalg.qr(random(300, 3, 3))[0].contiguous()
    lights = 2.4 * torch.nn.functional.normalize(random(24, 3), dim=-1)
    power, seen = torch.rand(24, 3, generator=generator), np.full((24, 38), 255, np.uint8)
    normals = axes[..., 2].contiguous()
    inputs = [tensor.requires_grad_() for tensor in (points, axes)]
    light = gather_light(*inputs, PointLights(lights, power, seen))
    gradients = torch.autograd.grad(light.square().sum(), inputs)
    points = points.detach()
    arriving = arriving_vectors(points, normals, PointLights(lights, power, seen))
    single = single_rays(points.double().numpy(), lights.double().numpy())
    for found in (light, *gradients, arriving, torch.from_numpy(single)):
        print(hashlib.sha256(found.detach().numpy().tobytes()).hexdigest())

for _ in range(2):
    child = os.fork()
    if not child:
        run()
        raise SystemExit
    assert os.waitpid(child, 0)[1] == 0
"""


def test_the_first_run_has_the_bits_of_the_next(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", SCRIPT]
    printed = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.split()
    assert list(tmp_path.rglob("*.nbc"))
    assert len(printed) == 10
    assert printed[:5] == printed[5:]
