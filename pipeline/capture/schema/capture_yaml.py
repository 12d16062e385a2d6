"""The keys of `capture.yaml`, format `lightstage-capture/1`.

A capture is one folder; `capture.yaml` at its root names everything else by paths relative to it. Nothing is guessed: a
key that is missing, unknown or of the wrong type is an error. Keys with a default may be left out. Tables and images
that the keys name are checked in `pipeline.capture.index.tables` and its neighbours.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from pipeline.capture.keypoint_orders import CHOICES
from pipeline.capture.mosaic import Mosaic
from pipeline.capture.schema.camera_schema import BoardCameras, CharucoCameras, KnownCameras
from pipeline.capture.schema.feature_schema import FeatureCameras
from pipeline.capture.schema.given_schema import Imported, Meshes
from pipeline.capture.schema.image_schema import Images, Masks
from pipeline.capture.schema.sections import (
    BallPattern,
    ChartPattern,
    CsvPath,
    Length,
    ParquetPath,
    Section,
    SilhouettePattern,
    Spectra,
    path_to,
)
from pipeline.capture.schema.template_schema import Template

NAME_PATTERN = r"^[A-Za-z0-9_][A-Za-z0-9_-]*$"


class MirrorBallLights(Section):
    """Light positions are measured from their mirror images in a ball."""

    method: Literal["mirror_ball"] = Field(description="which method this section is about")
    path: BallPattern = Field(description="pattern with {position}, {camera} and {light}: only that light is on")
    silhouette: SilhouettePattern = Field(
        description="pattern with {position} and {camera}: the ball dark before light"
    )
    radius_m: Length = Field(description="radius of the ball, metres")
    transfer: Literal["linear", "srgb"] = Field(
        "linear", description="how the ball images' stored values relate to light; srgb for a camera's JPEGs"
    )


class KnownLights(Section):
    """The surveyed light positions are taken as they are."""

    method: Literal["known"] = Field(description="which method this section is about")


class EarlierLights(Section):
    """Lights that were calibrated on an earlier day and have not moved; no ball is needed.

    Cameras in a frame of their own are placed by those that still stand where they stood, more than half.
    """

    method: Literal["earlier"] = Field(description="which method this section is about")
    lights: ParquetPath = Field(description="lights.parquet of the earlier calibration")
    cameras: Annotated[str, path_to(".json")] = Field(
        description="cameras.json of the earlier calibration; cameras of one name are compared"
    )


class ChartColor(Section):
    """Each camera's colours are corrected by what it sees of a chart."""

    method: Literal["chart"] = Field(description="which method this section is about")
    path: ChartPattern = Field(description="pattern with {camera}: one image of the chart under one constant light")
    patches: CsvPath = Field(
        description="csv: patch (from 1), and r, g, b (linear) or L, a, b (CIELAB); of charts other than the classic "
        "one of 24 patches also row and column, see config/charts"
    )
    illuminant: Literal["D50", "D65"] = Field("D50", description="light that L, a, b of the patches are for")
    transfer: Literal["linear", "srgb"] = Field(description="how the chart images' stored values relate to light")
    corners: CsvPath | None = Field(
        None,
        description="csv: camera, corner, x, y; where the chart lies, for cameras in which it is not found by itself: "
        "corners 0 to 3 are the outermost of the patches at the top left, top right, bottom right and bottom left (of "
        "the classic chart 1, 6, 24, 19), image pixels; of other charts for every camera",
    )
    mosaic: Mosaic | None = Field(
        None,
        description="images of the chart are raw mosaics of one channel: the colours of the first two pixels, then of "
        "those below; left out: three channels",
    )
    black_level: float | None = Field(
        None, ge=0, description="stored value of no light in images of the chart; left out: that of images"
    )
    exposures: CsvPath | None = Field(
        None,
        description="csv: camera, path, exposure_s; images of one scene at several exposure times, stored as those of "
        "the chart: the count from which a sensor is not linear is found from them",
    )


class KnownColor(Section):
    """Each camera's colours are corrected by a matrix that was found elsewhere."""

    method: Literal["known"] = Field(description="which method this section is about")
    path: Annotated[str, path_to(".json")] = Field(
        description="json: `cameras`, of each camera the 3 x 3 corrected-from-raw matrix of linear R, G, B; or 3 x 4, "
        "with a column that is added; or 3 x 5 to 3 x 35, the polynomials of Cheung et al. 2004"
    )


class NoColor(Section):
    """Colours are left as the cameras record them."""

    method: Literal["none"] = Field(description="which method this section is about")


class Calibration(Section):
    """Methods of calibrating the stage's cameras, lights and colours."""

    cameras: BoardCameras | CharucoCameras | KnownCameras | FeatureCameras = Field(
        discriminator="method", description="poses and lenses"
    )
    lights: MirrorBallLights | KnownLights | EarlierLights = Field(
        discriminator="method", description="positions of the LEDs"
    )
    color: ChartColor | KnownColor | NoColor = Field(
        discriminator="method", description="colour response of each camera"
    )


class Splits(Section):
    """Images held out for testing and for validation; everything else trains.

    Lists may be empty, and all but the first three may be left out. Where no `validation_` list is given, some of the
    training frames are held out, see `book_patterns`. What is listed for both is for testing.

    A pattern, the lit lights with their intensities, is named by the number of any frame that shows it. Holding it out
    holds out every frame that shows it.
    """

    test_cameras: list[str] = Field(description="cameras never trained on")
    test_frames: list[int] = Field(description="frame numbers never trained on")
    test_segments: list[str] = Field(description="segments never trained on")
    test_patterns: list[int] = Field([], description="frame numbers whose light patterns are never trained on")
    validation_cameras: list[str] | None = Field(None, description="cameras that choices are made on")
    validation_frames: list[int] | None = Field(None, description="frame numbers that choices are made on")
    validation_patterns: list[int] | None = Field(
        None, description="frame numbers whose light patterns choices are made on"
    )

    @property
    def names_validation(self) -> bool:
        """True if any list of validation images is given, even an empty one."""
        lists = (self.validation_cameras, self.validation_frames, self.validation_patterns)
        return any(given is not None for given in lists)


class Capture(Section):
    """All of `capture.yaml`."""

    format: Literal["lightstage-capture/1"] = Field(description="this format and its version")
    subject: str = Field(pattern=NAME_PATTERN, description="name of the subject: letters, digits, _ and -")
    kind: Literal["body", "head"] = Field(description="what of the subject is captured")
    units: Literal["m"] = Field(
        description="unit of every position", json_schema_extra={"hint": "convert lights.csv to metres and say m"}
    )
    up: Literal["+y"] = Field(
        description="the world's up axis",
        json_schema_extra={"hint": "rotate the world of lights.csv and of known cameras so that +y is up and say +y"},
    )
    fps: float = Field(gt=0, allow_inf_nan=False, description="frames per second")
    images: Images = Field(description="images of the subject")
    masks: Masks | None = Field(None, description="masks of the subject, if there are any")
    cameras: CsvPath = Field(description="csv: camera, width, height, sensor_width, sensor_height (pixels)")
    frames: CsvPath = Field(
        description="csv: frame, timestamp_s, segment; and exposure_s, gain where cameras changed them"
    )
    lights: CsvPath = Field(description="csv: light, x, y, z: surveyed, metres; they define the stage frame")
    patterns: CsvPath = Field(
        description="csv: frame, light, intensity (or intensity_r, intensity_g, intensity_b if lights are coloured); "
        "one row per lit light, unlisted = off"
    )
    spectra: Spectra | None = Field(None, description="colours of the lights, by their spectra")
    constant_light: bool = Field(
        False,
        description="true: the light never changes, and where it comes from is not known; lights and patterns then "
        "stand for it, all lit in every frame. Such a capture is tracked and gets avatars; these are not relit",
    )
    keypoints_2d: ParquetPath | None = Field(None, description="parquet: frame, camera, keypoint, x, y, confidence")
    keypoints_order: Literal[*CHOICES] | None = Field(
        None,
        description="order that keypoints of keypoints_2d are numbered or labelled in; left out: they are names of "
        "template.keypoints",
    )
    template: Template = Field(description="the mesh that is tracked")
    meshes: Meshes | None = Field(None, description="tracked elsewhere: the template's vertices, frame by frame")
    gaze: CsvPath | None = Field(
        None,
        description="csv: frame, eye, x, y, z; unit direction in which an eye of template.eyes looks, in the frame of "
        "the template at rest; frames without a row are interpolated between their neighbours",
    )
    calibration: Calibration = Field(description="how cameras, lights and colours are calibrated")
    splits: Splits = Field(description="what is held out for testing")
    imported: Imported | None = Field(
        None,
        description="of captures that import_capture writes: what was taken from a public set. Their images lie in the "
        "set's own folder, behind the link `source`",
    )
