"""Transfer that starts where the template at rest hides light: nothing of an open sheet, half of one beside a wall."""

import dataclasses

import numpy as np
import pytest
import torch

from pipeline.avatar.appearance.traced_transfer import even_directions, hidden_harmonics
from pipeline.avatar.appearance.transfer import UNTURNED_SCALE, shade_harmonics, start_harmonics
from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.posed_texels import rest_normals, texel_spacing
from pipeline.lighting.environment_sh import spherical_harmonics
from tests.support.avatars.sheet import SIDE_M, make_sheet

SAMPLED = 0.01
"""Of a coefficient: 1024 directions on a hemisphere's half know its area to about one in a hundred."""


def beside_a_wall(height=1e4):
    """The sheet with a wall along its edge x = SIDE / 2, so high that it hides all of that side."""
    sheet = make_sheet(8)
    x, y = SIDE_M / 2 + 1e-3, 1e4
    wall = np.array([[x, -y, -1.0], [x, y, -1.0], [x, y, height], [x, -y, height]], np.float32)
    return dataclasses.replace(
        sheet,
        rest_vertices=np.concatenate([sheet.rest_vertices, wall]),
        faces=np.concatenate([sheet.faces, [[4, 5, 6], [4, 6, 7]]]).astype(np.int32),
        uv=np.concatenate([sheet.uv, np.zeros((2, 3, 2), np.float32)]),
        weld=np.arange(8, dtype=np.int32),
    )


def test_an_open_surface_hides_nothing_of_itself():
    assert (hidden_harmonics(make_sheet(8)) == 0).all()


def test_a_wall_hides_half_of_the_light_and_the_half_it_hides_makes_no_light():
    atlas = beside_a_wall()
    hidden = hidden_harmonics(atlas)
    color, mono = start_harmonics(rest_normals(atlas))
    full = torch.cat([color[..., 0], mono], 1)
    # Lobe and wall are symmetric about y and z: of harmonics that are even in x, half is hidden.
    for index in (0, 2, 6):  # Y_00, Y_10, Y_20
        assert hidden[:, index].numpy() == pytest.approx(full[:, index].numpy() / 2, abs=SAMPLED * UNTURNED_SCALE)
    left = (color - hidden[:, :16, None], mono - hidden[:, 16:])
    for azimuth, share in ((np.pi, 1.0), (0.0, 0.0)):
        toward = torch.tensor([[np.cos(azimuth) * np.sin(0.7), 0.0, np.cos(0.7)]], dtype=torch.float32)
        light = spherical_harmonics(toward)[..., None]
        ones = torch.ones(len(hidden), 3)
        shade, lambert = (shade_harmonics(ones, *transfer, light).mean() for transfer in (left, (color, mono)))
        assert shade / lambert == pytest.approx(share, abs=0.15)  # degree 8 blurs the wall's edge over 20 degrees


def test_directions_are_even():
    directions = torch.as_tensor(even_directions(1024))
    assert torch.allclose(directions.norm(dim=1), torch.ones(1024, dtype=torch.float64))
    means = spherical_harmonics(directions).mean(0)
    assert means[1:].abs().max() < 1e-3


def test_a_new_avatar_starts_there_and_is_held_there():
    atlas = beside_a_wall()
    spec = AvatarSpec(False, False, 4, 1, 0.1, shading="harmonics", transfer_start="traced")
    new = Avatar(atlas, texel_spacing(atlas), spec)
    expected = start_harmonics(rest_normals(atlas))[1] - hidden_harmonics(atlas)[:, 16:]
    assert torch.equal(new.transfer_mono, expected) and torch.equal(new.start_transfer_mono, expected)
