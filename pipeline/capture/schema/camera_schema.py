"""Keys of `calibration.cameras`: ChArUco boards, or cameras calibrated elsewhere.

Each board has markers of its own.
"""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

import cv2
from pydantic import AfterValidator, Field, field_validator

from pipeline.capture.paths import check_relative, check_suffix
from pipeline.capture.schema.sections import Length, Section, ViewPattern
from pipeline.geometry.lenses import BROWN_CONRADY, LENSES

LARGEST_SQUARE_M = 1.0
"""No printed square is larger; any square above 1 cm is, if centimetres or millimetres are taken for metres."""


def _in_metres(length: float) -> float:
    if length > LARGEST_SQUARE_M:
        raise ValueError(f"metres, {LARGEST_SQUARE_M:g} at most (not centimetres or millimetres)")
    return length


BoardLength = Annotated[Length, AfterValidator(_in_metres)]


# `info` is pydantic's ValidationInfo: a protocol that run-time type checks cannot test for.
def _fits_a_square(marker_m: float | None, info: Any) -> float | None:
    square_m = info.data.get("square_m")
    if marker_m is not None and square_m is not None and marker_m >= square_m:
        raise ValueError(f"less than square_m, {square_m}")
    return marker_m


def _is_large_enough(dictionary: str | None, info: Any) -> str | None:
    if dictionary is None:
        return None
    if not dictionary.startswith("DICT_") or not hasattr(cv2.aruco, dictionary):
        raise ValueError("a predefined dictionary of cv2.aruco, for instance DICT_5X5_250")
    held = len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)).bytesList)
    # A marker lies in every other square.
    markers = (info.data.get("squares_x") or 0) * (info.data.get("squares_y") or 0) // 2
    needed = (info.data.get("first_marker") or 0) + markers
    if needed > held:
        raise ValueError(f"a dictionary of at least {needed} markers for this board (this one has {held})")
    return dictionary


class CharucoBoard(Section):
    """One of several ChArUco boards."""

    squares_x: int = Field(ge=2, description="squares of the board in x")
    squares_y: int = Field(ge=2, description="squares of the board in y")
    square_m: BoardLength = Field(description="side of a square, metres")
    marker_m: BoardLength = Field(description="side of a marker, metres; smaller than the square")
    first_marker: int = Field(0, ge=0, description="number of the board's first marker; the others follow it")
    dictionary: str = Field(description="a predefined dictionary of cv2.aruco, for instance DICT_5X5_250")

    _check_marker = field_validator("marker_m")(_fits_a_square)
    _check_dictionary = field_validator("dictionary")(_is_large_enough)


class CharucoCameras(Section):
    """Cameras are calibrated from images of one ChArUco board or a list of `boards`.

    Images are at sensor resolution. Boards need not be fixed to each other: each has its own pose in every view.
    """

    method: Literal["charuco"] = Field(description="which method this section is about")
    path: ViewPattern = Field(
        description="pattern with {camera} and {view:03d}; exists where the camera sees a board; views of one number "
        "were taken at once, and the numbers are in the order of time"
    )
    lens: Literal[tuple(LENSES)] = Field(
        BROWN_CONRADY.name,
        description="model of all lenses: brown_conrady (perspective; OpenCV's k1 k2 p1 p2 k3) or fisheye (OpenCV's k1 "
        "to k4), for lenses that see more than about 100 degrees",
    )
    boards: list[CharucoBoard] | None = Field(None, description="several boards, instead of the keys of one")
    squares_x: int | None = Field(None, ge=2, description="squares of the board in x", validate_default=True)
    squares_y: int | None = Field(None, ge=2, description="squares of the board in y", validate_default=True)
    square_m: BoardLength | None = Field(None, description="side of a square, metres", validate_default=True)
    marker_m: BoardLength | None = Field(
        None, description="side of a marker, metres; smaller than the square", validate_default=True
    )
    dictionary: str | None = Field(
        None, description="a predefined dictionary of cv2.aruco, for instance DICT_5X5_250", validate_default=True
    )

    _check_marker = field_validator("marker_m")(_fits_a_square)
    _check_dictionary = field_validator("dictionary")(_is_large_enough)

    @field_validator("boards")
    @classmethod
    def _share_no_marker(cls, boards: list[CharucoBoard] | None) -> list[CharucoBoard] | None:
        if boards == []:
            raise ValueError("at least one board")
        taken: dict[tuple[str, int], int] = {}
        for number, board in enumerate(boards or []):
            # DICT_5X5_50 is the beginning of DICT_5X5_250.
            family = re.sub(r"_\d+$", "", board.dictionary)
            last = board.first_marker + board.squares_x * board.squares_y // 2
            for marker in range(board.first_marker, last):
                if (other := taken.setdefault((family, marker), number)) != number:
                    raise ValueError(
                        f"boards that share no marker: boards {other} and {number} (counted from 0) both have marker "
                        f"{marker} of {family}; set first_marker"
                    )
        return boards

    @field_validator("squares_x", "squares_y", "square_m", "marker_m", "dictionary")
    @classmethod
    def _is_one_board_or_several(cls, value: Any, info: Any) -> Any:
        # A list of boards that is itself wrong is not in `data`: it has its own complaint.
        several = info.data.get("boards") is not None or "boards" not in info.data
        if value is None and not several:
            raise ValueError(f"{cls.model_fields[info.field_name].description} (or a list of boards)")
        if value is not None and info.data.get("boards") is not None:
            raise ValueError("either boards or the keys of one board")
        return value


class KnownCameras(Section):
    """Cameras were calibrated elsewhere."""

    method: Literal["known"] = Field(description="which method this section is about")
    format: Literal["cameras_json", "colmap", "nerfstudio"] = Field(
        "cameras_json",
        description="cameras_json: R, t, K, dist, width, height per camera, and lens: fisheye where dist is k1 to k4; "
        "colmap: the folder of a sparse model, text or binary; nerfstudio: a transforms.json. All at sensor "
        "resolution",
    )
    path: Annotated[str, AfterValidator(check_relative)] = Field(
        description="the .json file, or the folder of a COLMAP model"
    )
    scale_to_m: Length = Field(1.0, description="a length in metres is this times a length in the file")
    frame: Literal["stage", "own"] = Field(
        "stage",
        description="stage: that of the surveyed lights; own: any other, which mirror-ball images then lay over the "
        "stage's by turning and shifting it",
    )

    # `info` is pydantic's ValidationInfo: a protocol that run-time type checks cannot test for.
    @field_validator("path")
    @classmethod
    def _is_of_the_format(cls, path: str, info: Any) -> str:
        return path if info.data.get("format") == "colmap" else check_suffix(path, (".json",))
