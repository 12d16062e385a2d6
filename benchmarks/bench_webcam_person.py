"""A real person found by MediaPipe in four webcams: a part of docs/detection.md, and its picture.

    python -m benchmarks.bench_webcam_person --data ../shared/data/rig_caliscope

Needs `make detect`. Writes the part between the marks `webcams`.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from benchmarks.marked_page import paragraphs, write_between
from benchmarks.webcam_person import AGREE_PX, FACE, WebcamPerson, examine_person

PAGE, PICTURE = Path("docs/detection.md"), Path("docs/pictures/webcam_person.jpg")

MARKS = "webcams"

SHOWN_FRAME = 20
"""Of the picture: hands before the face, two of four faces found."""

COLORS = {FACE: (80, 220, 80), "mediapipe_pose_33": (60, 60, 255), "left_hand_21": (255, 160, 40),
          "right_hand_21": (40, 200, 255)}  # fmt: skip
"""By order, BGR."""

ABOUT = """\
A person who moves a board before four webcams, glasses on ([their rig](photographed_rigs.md)): {moments} moments, each
seen by all four. Found, of so many images:
"""

AGREE = """\
Points that two cameras or more are sure of, triangulated by the authors' cameras; wrong is farther than {px:.0f} pixels
from where the others have them. Images of a moment are up to a tenth of a second apart, and the hands move.
"""

AFTER = """\
Faces are missed where hands or the board are before them, and mostly from the side, as `cam_1` sees them. The irises
are {apart:.0f} mm apart in the median; of adults they are 54 to 74. Of {eyes} eyes {closed} are called closed; those
that were looked at are open.

![A person's points in four webcams](pictures/webcam_person.jpg)

*One moment: the body's points red, the face's green, hands blue and yellow. Photographs: caliscope, © 2024 Donald "Mac"
Prible, BSD-2-Clause.*
"""


def main() -> None:
    """Detect, compare, and write the part of the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--detector", default="", help="command; MediaPipe's of make detect if left out")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        person, points = examine_person(options.data, options.detector, Path(name))
        print(person)
        draw(points, PICTURE)
    write_between(PAGE, MARKS, [text_of(person).rstrip()])


def text_of(person: WebcamPerson) -> str:
    """The part of the page."""
    rows = ["| camera | body | face | a hand |", "|---|---|---|---|"]
    rows += [f"| {camera} | {' | '.join(map(str, counts))} |" for camera, counts in person.seen.items()]
    agree = ["| part | points | wrong | distance of the others, px |", "|---|---|---|---|"]
    agree += [f"| {part} | {a.points} | {a.wrong:.0%} | {a.pixels:.1f} |" for part, a in person.agreement.items()]
    about = paragraphs(ABOUT.format(moments=person.moments))
    between = paragraphs(AGREE.format(px=AGREE_PX))
    after = paragraphs(AFTER.format(apart=person.apart_mm, eyes=person.eyes, closed=person.closed or "none"))
    return "\n".join([about, "\n".join(rows), "", between, "\n".join(agree), "", after])


def draw(points: pd.DataFrame, path: Path) -> None:
    """Write the four views of a moment with their points."""
    panels = []
    for _, own in points[points.frame == SHOWN_FRAME].groupby("camera"):
        image = cv2.imread(own.path.iloc[0])
        for point in own.itertuples():
            at = (round(point.x), round(point.y))
            cv2.circle(image, at, 2 if point.order == FACE else 5, COLORS[point.order], -1, cv2.LINE_AA)
        panels.append(cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
    rows = [np.concatenate(panels[:2], 1), np.concatenate(panels[2:], 1)]
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), np.concatenate(rows), [cv2.IMWRITE_JPEG_QUALITY, 80]):
        raise OSError(f"{path}: could not be written")


if __name__ == "__main__":
    main()
