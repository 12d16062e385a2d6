"""Text of the page that bench_detection writes."""

from __future__ import annotations

import textwrap
from dataclasses import asdict, dataclass

from pipeline.capture.keypoint_orders import CHOICES, read_orders


@dataclass(frozen=True)
class Found:
    """What a detector made of a capture.

    Attributes:
        images, seen: that it looked at, and in which it found keypoints.
        keypoints: of the template that it knows, of all.
        pixels: median distance from the reference, of those that are not wrong.
        wrong: share of detections that are.
        overlap: median intersection over union of the masks with the capture's.
        tracked_mm: error of the tracked template with these keypoints and masks, and with the capture's own.
    """

    name: str
    images: int
    seen: int
    keypoints: tuple[int, int]
    pixels: float
    wrong: float
    overlap: float
    tracked_mm: tuple[str, str]


@dataclass(frozen=True)
class Looks:
    """Gaze of a drawn head with detected irises and without.

    Attributes:
        iris_px: width of an iris in a frontal image.
        visible, found, iris_error_px: irises that can be seen, those found, and their median error.
        unseen: irises found where none is to be seen.
        alone_deg, with_deg: root mean square errors over both eyes and the fully lit frames.
    """

    name: str
    iris_px: float
    visible: int
    found: int
    iris_error_px: float
    unseen: int
    alone_deg: float
    with_deg: float


@dataclass(frozen=True)
class RealFace:
    """What is found of a real face, eyes closed: photographs, with its mesh, with a body, eyes, those called closed."""

    photographs: int
    faces: int
    bodies: int
    eyes: int
    closed: int


HEAD = """\
# Keypoints and masks of photographs

<!-- Written by `python -m benchmarks.bench_detection`: change it there. -->

A capture of photographs alone, without keypoints or masks, gets them from two stages, which look at fully lit frames
only; the tracker carries the template through the others.

- `detect_landmarks` finds bodies, faces with irises, and hands. It is used where `keypoints_2d` is missing, once
  `make detect` has set up MediaPipe in `.venv-detect` (its models come with its package; it wants another NumPy than
  the stages). `detect_landmarks: {use: always}` takes it in place of the capture's keypoints, `never` nowhere.
- `segment_subject` masks the subject: by what differs from `masks.clean_plates`, each camera's image of the empty,
  fully lit stage, where the capture has these; else by a network, where masks are missing and `make detect` was run.

Both write into `results/<subject>/detected/`, with a picture to judge them by; `index_capture` takes them from there
and says so. `make results/<subject>/detected/landmarks.png` looks without using it.

## Points and orders

The template's keypoints (`template.keypoints`) are matched by name: call them by the points below, or say in
`template.points`, a csv of `keypoint,point`, which points they are. Points that a template lacks are left out. Tables
of other detectors are read by `keypoints_order`, whose keypoints are numbers from 0 or the order's own labels:

{orders}

A face's points are those of iBUG, `face_0` to `face_67`, and in WFLW and MediaPipe also `left_eye_upper`,
`left_eye_lower`, `left_pupil` and those of the right.

Irises and contours of eyes need no keypoint of the template: `index/eye_points.parquet` keeps them. `estimate_gaze`
weighs irises against what pixels say of the gaze, lets them stand in where pixels say nothing, and takes eyes with
closed contours for closed.

Left and right are the person's. The table is `pipeline/capture/keypoint_orders.csv`.

## Another detector

`detector` of both stages is a command that is started as `COMMAND landmarks --images images.csv --out points.csv
--parts body face hands --least 0.5`, and `COMMAND masks --images images.csv --out FOLDER`. `images.csv` has `image`,
`path` (8-bit sRGB), `camera`, `frame`; `points.csv` gets `image`, `order`, `number`, `x`, `y` (pixels, the image's
corner is 0, 0), `confidence`, and the folder a mask `IMAGE.png` per image, 255 = subject.

## What MediaPipe finds

"""


def orders_table() -> str:
    """Rows of the orders, with their first points."""
    rows = ["| `keypoints_order` | keypoints | first points |", "|---|---|---|"]
    for name in CHOICES:
        points = read_orders()[name].points
        rows.append(f"| `{name}` | {len(points)} | {', '.join(points[:3])} |")
    return "\n".join(rows)


def gaze_table(looks: list[Looks]) -> str:
    """What detected irises are worth."""
    rows = [
        "| capture | width of an iris | irises found | median error | found where none is to be seen | "
        "gaze by pixels alone | with detected irises |",
        "|---|---|---|---|---|---|---|",
    ]
    for each in looks:
        rows.append(
            f"| {each.name} | {each.iris_px:.0f} px | {each.found} of {each.visible} | {each.iris_error_px:.2f} px | "
            f"{each.unseen} | {each.alone_deg:.2f}° | {each.with_deg:.2f}° |"
        )
    return GAZE + "\n".join(rows) + "\n"


GAZE = """
### Irises and gaze

Irises that MediaPipe finds in fully lit images of drawn heads, and the gaze that `estimate_gaze` makes of these and of
the pixels; root mean square angle to the truth, of both eyes. Irises found on the far side of a head do not agree with
others and are left out. `benchmarks/head_close_up.yaml` is `closeup`.

"""


REAL_FACE = """\
One person, of whom there are {photographs} photographs, each under one lamp close by (`face_near_lights`, eyes closed).
The face was found in {faces}, a body, of which only the neck shows, in {bodies}. Closed eyes have
irises all the same, as the mesh comes as a whole; by their contours {closed} of {eyes} eyes are closed, and their
irises do not count.
"""


WEBCAMS = """
### A real person

<!-- webcams: begin -->
{part}<!-- webcams: end -->
"""
"""Written by `bench_webcam_person`."""


def page(found: list[Found], looks: list[Looks], face: RealFace | None, webcams: str) -> str:
    """The page, with a row for each capture.

    Args:
        webcams: the part that `bench_webcam_person` wrote.
    """
    rows = [
        "| capture | images with keypoints | template's keypoints known | wrong | error of the others | masks, IoU | "
        "tracked with these, mm | with the capture's own, mm |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for each in found:
        mine, own = each.tracked_mm
        rows.append(
            f"| {each.name} | {each.seen} of {each.images} | {each.keypoints[0]} of {each.keypoints[1]} | "
            f"{each.wrong:.0%} | {each.pixels:.1f} px | {each.overlap:.2f} | {mine} | {own} |"
        )
    text = HEAD.replace("{orders}", orders_table())
    text += (
        "Synthetic captures, whose truth is known; wrong is farther from where a keypoint is than 5 % of the image's "
        "height.\nMasks are compared with the capture's. Tracked: median and 90th percentile of the vertices' distance "
        "from the truth,\nafter one rigid motion.\n\n" + "\n".join(rows) + "\n"
    )
    if looks:
        text += gaze_table(looks)
    if face is not None:
        text += "\n### A real face, eyes closed\n\n" + textwrap.fill(REAL_FACE.format(**asdict(face)), 120) + "\n"
    return text + WEBCAMS.format(part=webcams) + "\n" + LIMITS


LIMITS = """\
## What to know

- A face's mesh has no confidence of its own, each point has 0.9. Faces are also found at the back and the side of a
  head. Points that agree with no other camera are left out by the tracker; where they are most, as with cameras all
  around a head, it refuses the capture and says so. Cameras behind the head are best left out of such a table.
- A body's points of hidden limbs are guesses with less confidence.
- The network's masks are as coarse as its 256 x 256 pixels, and round off fingers; clean plates are exact to a pixel,
  but what is as black as the stage, such as hair, is lost at the outline.
"""
