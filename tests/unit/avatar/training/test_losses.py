"""Every term of the loss: its value where it can be said on paper, and a finite gradient where it could break."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.avatar.appearance.penalties import negative, total_variation
from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar, Picture
from pipeline.avatar.spec.planned import resolve_spec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training import losses
from pipeline.base.errors import InputError
from pipeline.config.train_avatar import TrainAvatar
from pipeline.geometry.texels import adjoining_texels, texels_side_by_side
from pipeline.metrics.lpips import BACKBONES, Lpips, build_features, linear_weights
from pipeline.metrics.shift_tolerant_lpips import open_st_lpips
from pipeline.rendering.splat_types import CameraView
from tests.support.avatars.sheet import make_frame, make_sheet

K = torch.tensor([[10.0, 0, 4], [0, 10.0, 4], [0, 0, 1]])
VIEW = CameraView(torch.eye(3), torch.zeros(3), K, 4, 4)


def gradient(term, value):
    (found,) = torch.autograd.grad(term, value)
    assert torch.isfinite(found).all()
    return found


def test_colours_are_compared_as_srgb_encodes_them():
    """Linear 0.18 and 0.5 are 0.4614 and 0.7354 in IEC 61966-2-1; equal greys differ by nothing."""
    mask, gray = torch.ones(4, 4), torch.full((4, 4, 3), 0.18)
    assert losses.photometric(gray, gray, mask, "captured").item() == 0
    half = torch.full((4, 4, 3), 0.5)
    assert losses.photometric(half, gray, mask, "captured").item() == pytest.approx(0.7354 - 0.4614, abs=1e-4)
    assert losses.photometric(half, gray, mask, "captured", "linear").item() == pytest.approx(0.32, rel=1e-6)


def test_alpha_sparsity_is_the_distance_to_0_or_1_away_from_the_edge():
    mask = torch.zeros(8, 8)
    mask[1:7, 1:7] = 1
    alpha = mask.clone()
    alpha[0, :] = 0.5  # touches the edge
    alpha[3, 3], alpha[4, 4] = 0.7, 0.1
    alpha.requires_grad_()
    term = losses.alpha_sparsity(alpha, mask)
    assert term.item() == pytest.approx((0.3 + 0.1) / 36)
    slope = gradient(term, alpha)
    assert slope[3, 3] == pytest.approx(-1 / 36) and slope[4, 4] == pytest.approx(1 / 36)
    assert (slope[0] == 0).all()
    assert losses.alpha_sparsity(torch.full((8, 8), 0.5), torch.zeros(8, 8)).isfinite()


@pytest.mark.parametrize("degrees", [0.0, 60.0, 90.0, 120.0, 180.0])
def test_normals_that_face_away_are_punished_and_visible_ones_are_not(degrees):
    """One pixel on the axis of a turned camera, its normal so far from the direction to the camera: max(0, -cos)^2."""
    R = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(0)))[0]
    R = R * torch.linalg.det(R).sign()
    pinhole = torch.tensor([[10.0, 0, 0.5], [0, 10.0, 0.5], [0, 0, 1]])
    angle = math.radians(degrees)
    in_camera = torch.tensor([math.sin(angle), 0.0, -math.cos(angle)])  # z points away from the camera
    normal = (0.3 * in_camera @ R)[None, None].requires_grad_()
    term = losses.normal_orient(normal, torch.ones(1, 1), CameraView(R, torch.zeros(3), pinhole, 1, 1))
    assert term.item() == pytest.approx(max(0.0, -math.cos(angle)) ** 2, abs=1e-6)
    slope = gradient(term, normal)
    if degrees == 120:
        assert (slope[0, 0] @ R.T)[2] > 0  # downhill is towards the camera


def test_normal_orient_is_finite_for_no_normal_and_no_pixel():
    normal = torch.zeros(4, 4, 3, requires_grad=True)
    assert (gradient(losses.normal_orient(normal, torch.ones(4, 4), VIEW), normal) == 0).all()
    assert losses.normal_orient(normal, torch.zeros(4, 4), VIEW).item() == 0


def test_lpips_is_zero_for_the_capture_itself_and_its_gradient_finite_on_black():
    """With a random backbone: the published one is not shipped. The picture is smaller than LPIPS can take."""
    torch.manual_seed(0)
    lpips = Lpips(BACKBONES["alex"].taps, build_features("alex"), linear_weights("alex"))
    captured, mask = torch.rand(20, 40, 3), torch.ones(20, 40)
    mask[:, 30:] = 0
    assert losses.lpips_loss(lpips, captured * mask[..., None], captured, mask).item() == 0
    black = torch.zeros(20, 40, 3, requires_grad=True)
    term = losses.lpips_loss(lpips, black, captured, mask)
    assert term.item() > 0
    assert gradient(term, black).abs().sum() > 0


def test_st_lpips_is_a_term_where_it_has_a_weight():
    captured, mask, found = torch.full((30, 20, 3), 0.5), torch.ones(30, 20), {}
    for weight in (0.0, 0.2):
        picture = Picture(torch.zeros(30, 20, 3), mask)
        found[weight] = losses.reconstruction(picture, captured, mask, VIEW, TrainAvatar(weight_st_lpips=weight))
    assert "st_lpips" not in found[0.0]
    assert found[0.2]["st_lpips"].item() == pytest.approx(
        0.2 * losses.lpips_loss(open_st_lpips(), torch.zeros(30, 20, 3), captured, mask).item()
    )


def test_lpips_without_its_weights_is_told(tmp_path):
    with pytest.raises(InputError, match="expected the LPIPS backbone"):
        losses.open_lpips_loss("alex", str(tmp_path / "none.pth"))


def test_negative_values_count_squared():
    values = torch.tensor([-2.0, 0.0, 3.0], requires_grad=True)
    term = negative(values)
    assert term.item() == pytest.approx(4 / 3)
    assert gradient(term, values).tolist() == pytest.approx([-4 / 3, 0, 0])


def test_weight_of_normals_falls_in_a_straight_line():
    papers = TrainAvatar(weight_normal=1.0, normal_steps=20000)
    found = [losses.normal_weight(papers, step) for step in (0, 5000, 20000, 300000)]
    assert found == pytest.approx([1, 0.75, 0, 0])
    assert losses.normal_weight(TrainAvatar(weight_normal=0.3), 10**6) == 0.3


def test_terms_of_the_parameters_have_their_papers_values():
    atlas = make_sheet(4)
    settings = TrainAvatar(
        shadow="off", weight_size=1.0, weight_albedo=0.01, weight_offset=0.05, weight_negative=0.01, weight_normal=1.0,
        normal_steps=10,
    )  # fmt: skip
    avatar = Avatar(atlas, texel_spacing(atlas), resolve_spec(settings, {"near_field", "articulation", "specular"}))
    with torch.no_grad():
        avatar.albedo.copy_(torch.tensor([0.5, -0.25, 0.0]))
        avatar.log_scale.fill_(math.log(2e-3))
        avatar.offset.copy_(avatar.spacing.mean(-1, keepdim=True) * torch.tensor([1.0, 2.0, 0.0]))
        avatar.normal_offset.fill_(0.5)
    frame = avatar.prepare(FrameInputs(atlas, make_frame(atlas, np.array([[0.0, 0, 1]]), np.ones((1, 3)))))
    terms = losses.regularization(avatar, frame, settings, step=4)
    assert terms["size"].item() == pytest.approx(2e-3, rel=1e-5)
    assert terms["albedo"].item() == pytest.approx(0.01 * 0.25, rel=1e-5)
    assert terms["offset"].item() == pytest.approx(0.05 * 5 / 3, rel=1e-5)
    assert terms["normal"].item() == pytest.approx(0.6 * 0.25, rel=1e-5)
    below = 0.01 * (0.25**2 / 3 + frame.shading.diffuse.detach().clamp_max(0).square().mean().item())
    assert terms["negative"].item() == pytest.approx(below, rel=1e-5)
    for name, parameter in (("size", avatar.log_scale), ("albedo", avatar.albedo), ("offset", avatar.offset)):
        assert gradient(terms[name], parameter).abs().sum() > 0


def test_total_variation_by_hand_and_the_share_of_each_image():
    """A 4 x 4 map of two charts, columns 0 and 1 against 2 and 3: a step between charts is none."""
    atlas = replace(make_sheet(4), chart=np.tile([0, 0, 1, 1], 4).astype(np.int32))
    pairs = torch.as_tensor(texels_side_by_side(adjoining_texels(atlas)))
    assert pairs.shape == (2, 4 * 2 + 3 * 4)
    flat = torch.tensor([0.0, 0.0, 5.0, 5.0]).repeat(4)[:, None].repeat(1, 3).requires_grad_()
    assert total_variation(flat, pairs).item() == 0
    assert gradient(total_variation(flat, pairs), flat).abs().max() == 0
    bump = torch.zeros(16)
    bump[5] = 2.0  # row 1, column 1: neighbours on the left, above and below, none of its chart on the right
    assert total_variation(bump, pairs).item() == pytest.approx(3 * 2.0 / 16, rel=2e-3)

    settings = TrainAvatar(shadow="off", weight_smooth=0.6)
    avatar = Avatar(atlas, texel_spacing(atlas), resolve_spec(settings, {"near_field", "specular"}))
    with torch.no_grad():
        avatar.albedo[5, 1] += 2.0
    frame = avatar.prepare(FrameInputs(atlas, make_frame(atlas, np.array([[0.0, 0, 1]]), np.ones((1, 3)))))
    terms = [losses.regularization(avatar, frame, settings, images=count) for count in (1, 30)]
    assert terms[0]["smooth"].item() == pytest.approx(0.6 * 3 * 2.0 / 16, rel=2e-3)
    assert terms[1]["smooth"].item() == pytest.approx(terms[0]["smooth"].item() / 30)


def test_terms_of_weight_zero_are_not_computed():
    picture = Picture(torch.zeros(4, 4, 3), torch.ones(4, 4), torch.ones(4, 4, 3))
    shown = (torch.zeros(4, 4, 3), torch.ones(4, 4), VIEW)
    assert set(losses.reconstruction(picture, *shown, TrainAvatar())) == {"photometric", "silhouette"}
    papers = TrainAvatar(weight_normal_orient=0.1, weight_alpha_sparsity=0.1)
    assert set(losses.reconstruction(picture, *shown, papers)) == {
        "photometric", "silhouette", "normal_orient", "alpha_sparsity"
    }  # fmt: skip
    without = replace(picture, normal=None)  # a lobe that is not deferred
    assert "normal_orient" not in losses.reconstruction(without, *shown, papers)
