"""Settings of plan_effects, and how its thresholds come about.

Where a threshold bounds an error of the picture, the yardstick is a capture's own noise: 40 dB, or 1 % of full scale.
An effect that changes less than that is not worth simulating.
"""

from pydantic import Field

from pipeline.config.effects import Mode
from pipeline.config.settings import Settings

SHADOW_PERCENT = 1.0
"""Share of facing pairs blocked from afar. A share s of a frame's light arriving where it should not is, with n lights
lit, an error of 1/n of a pixel's light in a share n s of the pixels: a mean square of s/n times that of the picture
(~0.1 of full scale squared, foreground). s = 1 % and n = 8 lights give 1e-4 x 1.25: 39 dB, the noise."""

ARTICULATION_DEGREES = 2.0
"""Spread of a joint's rotation. Turning a cosine lobe by a changes it by a sin(angle), root mean square 0.58 a over
directions; at 0.6 of full scale 2 degrees make 1.2 %, the noise."""

NEAR_FIELD_PERCENT = 3.0
"""Change of a light over the subject. The mean foreground is about 0.3 of full scale: 3 % of it is 1 %, the noise. The
direction to the light changes by half as much in radians as the intensity does relatively, so it needs no test of its
own."""

SPECULAR_DB = 0.1
"""What gloss explains of texels' colours. An effect whose mean square is 2.3 % of what is left anyway costs 0.1 dB when
it is left out, about what another seed makes. A trained avatar leaves more than the fit of single texels does
(measured: 27 to 35 dB against 35 to 37), so it loses less than this number says."""

DEFERRED_DB = 0.1
"""What shading per Gaussian loses: as for gloss."""

LEARNED_TRANSPORT_DB = 0.9
"""What light from below the surface explains beyond GGX, traced visibility and one bounce. What is translucent measures
7.0 dB (a body) and 1.2 dB (one ball of two), what is opaque up to 0.6 dB (a bust), which are bounces that the fit does
not know: 0.9 dB lies between, in the middle of their logarithms."""

LENS_DISTORTION_PX = 0.1
"""Displacement in pixels of the images used. A step edge off by a tenth of a pixel is wrong by 10 % of its contrast in
a line one pixel wide; 3 mm of tracking error, a third of a pixel of 9 mm, was measured to cost 0.9 dB, and the cost is
quadratic: 0.1 px is below 0.1 dB."""

COLOR_CORRECTION_PERCENT = 1.0
"""Largest deviation of a colour matrix from the identity. 1 % is what a chart calibrates to, and a third of the
noise."""


class PlanEffects(Settings):
    """Effects that are simulated.

    `on` and `off` are obeyed, `auto` is decided by a measurement on this capture.
    """

    shadow: Mode = Field("auto", description="shadows cast by distant parts of the subject")
    near_field: Mode = Field("auto", description="lights at their true, finite distance")
    articulation: Mode = Field("auto", description="light transport that turns with the limbs")
    specular: Mode = Field("auto", description="gloss")
    deferred: Mode = Field("auto", description="gloss shaded per pixel, not per Gaussian")
    learned_transport: Mode = Field("auto", description="light that leaves a surface elsewhere than it enters")
    eyes: Mode = Field("auto", description="eyes as spheres that turn with the gaze, if the capture declares both")
    lens_distortion: Mode = Field("auto", description="removal of the lenses' distortion")
    color_correction: Mode = Field("auto", description="removal of the cameras' colour differences")
    shadow_percent: float = Field(SHADOW_PERCENT, ge=0, le=100, description="shadow is on above this share [%]")
    articulation_degrees: float = Field(
        ARTICULATION_DEGREES, ge=0, le=180, description="articulation is on above this spread [degrees]"
    )
    near_field_percent: float = Field(NEAR_FIELD_PERCENT, ge=0, description="near field is on above this spread [%]")
    specular_db: float = Field(SPECULAR_DB, description="specular is on above this gain [dB]")
    deferred_db: float = Field(DEFERRED_DB, description="deferred is on above this loss without it [dB]")
    learned_transport_db: float = Field(
        LEARNED_TRANSPORT_DB, description="learned transport is on above this gain [dB]"
    )
    lens_distortion_px: float = Field(
        LENS_DISTORTION_PX, ge=0, description="lens distortion is on above this displacement [image pixels]"
    )
    color_correction_percent: float = Field(
        COLOR_CORRECTION_PERCENT, ge=0, description="colour correction is on above this deviation [%]"
    )
    local_radius_percent: float = Field(
        2.0, gt=0, le=100, description="occluders nearer than this share of the subject's extent are local shape [%]"
    )
    rays: int = Field(4096, ge=64, le=10_000_000, description="random (texel, lit light, frame) rays for the evidence")
    frames: int = Field(64, ge=1, description="at most so many lit frames are looked at, drawn at random [frames]")
    texels: int = Field(2000, ge=16, description="texels whose colours are looked up in training images, at random")
    fully_lit_frames: int = Field(3, ge=1, description="fully lit training frames they are looked up in [frames]")
    partially_lit_frames: int = Field(6, ge=1, description="partially lit training frames as well [frames]")
    views: int = Field(16, ge=1, description="training cameras they are looked up in, at most")
    bounce_rays: int = Field(16, ge=1, description="rays per texel for light off other texels")
