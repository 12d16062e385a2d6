"""Distant lights in harmonics: against the float64 twin, and against point lights that are far away."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.lighting.distant import FAR_M, LIGHTS_THAT_PAY, far_lights, gather_distant, light_harmonics
from pipeline.lighting.environment_sh import gather_environment
from pipeline.lighting.point_lights import PointLights
from pipeline.lighting.zonal import gather_light
from tests.support.avatars.sheet import make_frame, make_sheet
from tests.support.rigs.random_lights import FLOAT32_SUM, random_scene


@pytest.mark.parametrize("channels", [1, 3])
def test_kernel_equals_float64_twin_forward_and_backward(channels):
    place, axes, lights, intensity = random_scene(200, 24, channels)
    axes[0] = torch.eye(3)  # the poles are on z
    light = light_harmonics(place.mean(0), torch.eye(3), PointLights(lights, intensity))
    twin = axes.double().requires_grad_()
    out = gather_distant(axes.requires_grad_(), light)
    expected = gather_environment(twin, light.double())
    assert (out - expected).abs().max() < FLOAT32_SUM
    cotangent = torch.randn(out.shape, generator=torch.Generator().manual_seed(1))
    out.backward(cotangent)
    expected.backward(cotangent.double())
    assert torch.isfinite(axes.grad).all()
    assert (axes.grad - twin.grad).norm() / twin.grad.norm() < 1e-5


def test_far_point_lights_gather_the_same_up_to_their_distance():
    place, axes, lights, intensity = random_scene(100, 5, 3, seed=2)
    center = place.mean(0)
    gathered = gather_distant(axes, light_harmonics(center, torch.eye(3), PointLights(lights, intensity)))
    near = gather_light(place, axes, far_lights(center, PointLights(lights, intensity)))
    # Points lie within 2 m: w changes by 2 / FAR_M, P_8 by 36 times that, and 5 lights of 17 / (4 pi) / 2.4^2 add up.
    assert (gathered - near).abs().max() < 2 * 36 / FAR_M * 5 * 17 / (4 * torch.pi) / 2.4**2 + FLOAT32_SUM


def test_turned_light_is_light_seen_from_a_turned_frame():
    place, axes, lights, intensity = random_scene(50, 7, 1, seed=3)
    turn = axes[0]
    turned = light_harmonics(place.mean(0), turn, PointLights(lights, intensity))
    straight = light_harmonics(place.mean(0), torch.eye(3), PointLights(lights, intensity))
    assert (gather_distant(turn @ axes, turned) - gather_distant(axes, straight)).abs().max() < FLOAT32_SUM


def test_few_or_many_lights_give_one_picture_of_an_avatar_far_from_them():
    """Without near field, light comes by a sum over lights or by harmonics; with it, from where it is."""
    atlas = make_sheet(8)
    near = AvatarSpec(specular=False, shadow=False, shadow_width=4, supersample=1, dilation_px2=0.1)
    for count in (LIGHTS_THAT_PAY - 1, LIGHTS_THAT_PAY):
        lights = np.random.default_rng(count).normal((0, 0, 3), 1, (count, 3))
        inputs = FrameInputs(atlas, make_frame(atlas, 1e4 * lights, np.full((count, 3), 1e8)))
        shown = [
            Avatar(atlas, texel_spacing(atlas), spec).prepare(inputs).shading.diffuse
            for spec in (near, replace(near, near_field=False), replace(near, near_field=False, shading="harmonics"))
        ]
        # The sheet is 0.4 m wide, the lights are further than 1e4 m away: directions differ by 3e-5.
        for other in shown[1:]:
            assert (other - shown[0]).abs().max() < 1e-3 * shown[0].abs().max()


@pytest.mark.parametrize("degrees", [2, 5, 9])
def test_fewer_degrees_are_the_first_of_all(degrees):
    place, axes, lights, intensity = random_scene(30, 6, 3, seed=5)
    light = light_harmonics(place.mean(0), torch.eye(3), PointLights(lights, intensity))
    expected = gather_environment(axes.double(), light.double())[:, :, :degrees]
    for gather in (gather_distant, gather_environment):
        assert gather(axes, light[: degrees**2]).shape[2] == degrees
        assert (gather(axes, light[: degrees**2]) - expected).abs().max() < FLOAT32_SUM
