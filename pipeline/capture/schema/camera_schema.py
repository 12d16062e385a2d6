"""Keys of `calibration.cameras`: photographed boards, or cameras calibrated elsewhere."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, field_validator

from pipeline.capture.paths import check_relative, check_suffix
from pipeline.capture.schema.board_schema import (
    BoardLength,
    CharucoBoard,
    Checkerboard,
    CircleGrid,
    TagGrid,
    check_markers,
    fits_a_square,
    holds_a_charuco_board,
)
from pipeline.capture.schema.sections import BoardPattern, CsvPath, Length, Section
from pipeline.geometry.lenses import BROWN_CONRADY, LENSES

CAMERA_SUFFIXES: dict[str, tuple[str, ...] | None] = {
    "cameras_json": (".json",),
    "colmap": None,
    "nerfstudio": (".json",),
    "caliscope": (".toml",),
    "metashape": (".xml",),
    "qualisys": (".txt", ".xml"),
    "easymocap": None,
    "opencv": None,
    "auto": None,
}
"""Formats of cameras calibrated elsewhere, and how names of such files end; None: a folder, or any name."""


class CameraFile(Section):
    """Cameras that were calibrated elsewhere."""

    format: Literal[tuple(CAMERA_SUFFIXES)] = Field(
        "cameras_json",
        description="cameras_json: R, t, K, dist, width, height per camera, and lens: fisheye where dist is k1 to k4; "
        "colmap: the folder of a sparse model, text or binary; nerfstudio: a transforms.json; caliscope: its "
        ".toml of cameras; metashape: its .xml of exported cameras; "
        "qualisys: the calibration that QTM exports, .txt or .xml, cameras named by serial number, in mm; "
        "easymocap: a folder of intri.yml and extri.yml; "
        "opencv: a rig's .yml, .xml or .json as OpenCV's programs write it, or a folder of one per camera; "
        "auto: the one of these that it is. All at sensor resolution",
    )
    path: Annotated[str, AfterValidator(check_relative)] = Field(description="the file, or the folder of a model")

    # `info` is pydantic's ValidationInfo: a protocol that run-time type checks cannot test for.
    @field_validator("path")
    @classmethod
    def _is_of_the_format(cls, path: str, info: Any) -> str:
        suffixes = CAMERA_SUFFIXES.get(info.data.get("format", "auto"))
        return path if suffixes is None else check_suffix(path, suffixes)


class PhotographedBoards(Section):
    """Cameras are calibrated from images of boards, at sensor resolution.

    Boards need not be fixed to each other: each has its own pose in every view.
    """

    method: Literal["boards", "charuco"] = Field(description="which method this section is about")
    path: BoardPattern = Field(
        description="pattern with {camera} and {view:03d}; exists where the camera sees a board; views of one number "
        "were taken at once, and the numbers are in the order of time. Or videos, {camera}.mp4: frame 12 is view 12"
    )
    lens: Literal[tuple(LENSES)] = Field(
        BROWN_CONRADY.name,
        description="model of all lenses: brown_conrady (perspective; OpenCV's k1 k2 p1 p2 k3) or fisheye (OpenCV's k1 "
        "to k4), for lenses that see more than about 100 degrees",
    )
    times: CsvPath | None = Field(
        None,
        description="csv: camera, view, time_s; when each image was taken, where a view's images were not taken at "
        "once: the board may move between them",
    )
    intrinsics: Literal["estimate", "refine", "known"] = Field(
        "estimate",
        description="estimate: lenses are found from the boards alone; refine: those of lenses_from are a prior; "
        "known: they stay as they are, and only poses are found",
    )
    lenses_from: CameraFile | None = Field(
        None, description="lenses for refine or known, whose poses do not count", validate_default=True
    )

    @field_validator("lenses_from")
    @classmethod
    def _is_given_if_needed(cls, lenses: CameraFile | None, info: Any) -> CameraFile | None:
        needed = info.data.get("intrinsics", "estimate") != "estimate"
        if needed and lenses is None:
            raise ValueError(f"a file of lenses, format and path, for intrinsics: {info.data['intrinsics']}")
        if not needed and lenses is not None and "intrinsics" in info.data:
            raise ValueError("no lenses for intrinsics: estimate (or say intrinsics: refine or known)")
        return lenses


class BoardCameras(PhotographedBoards):
    """Cameras are calibrated from images of boards of any kind.

    At least one list of boards is given.
    """

    method: Literal["boards"] = Field(description="which method this section is about")
    charuco: list[CharucoBoard] = Field([], description="ChArUco boards")
    tag_grids: list[TagGrid] = Field([], description="grids of AprilTags or ArUco markers")
    checkerboards: list[Checkerboard] = Field([], description="checkerboards")
    circle_grids: list[CircleGrid] = Field([], description="grids of circles", validate_default=True)

    @field_validator("circle_grids")
    @classmethod
    def _are_some(cls, grids: list[CircleGrid], info: Any) -> list[CircleGrid]:
        kinds = ("charuco", "tag_grids", "checkerboards")
        # A list that is itself wrong is not in `data`: it has its own complaint.
        if not grids and all(info.data.get(kind) == [] for kind in kinds):
            raise ValueError(f"at least one board under {', '.join(kinds)} or circle_grids")
        check_markers([*info.data.get("charuco", []), *info.data.get("tag_grids", [])])
        plain = [*info.data.get("checkerboards", []), *grids]
        if any(plain.count(board) > 1 for board in plain):
            raise ValueError("boards without markers that differ: two that are alike cannot be told apart")
        return grids


class CharucoCameras(PhotographedBoards):
    """Cameras are calibrated from images of one ChArUco board or a list of `boards`.

    Short for method boards. Images are at sensor resolution. Boards need not be fixed to each other: each has its own
    pose in every view.
    """

    method: Literal["charuco"] = Field(description="which method this section is about")
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

    _check_marker = field_validator("marker_m")(fits_a_square)
    _check_dictionary = field_validator("dictionary")(holds_a_charuco_board)

    @field_validator("boards")
    @classmethod
    def _share_no_marker(cls, boards: list[CharucoBoard] | None) -> list[CharucoBoard] | None:
        if boards == []:
            raise ValueError("at least one board")
        check_markers(boards or [])
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


class KnownCameras(CameraFile):
    """Cameras were calibrated elsewhere."""

    method: Literal["known"] = Field(description="which method this section is about")
    scale_to_m: Length = Field(1.0, description="a length in metres is this times a length in the file")
    frame: Literal["stage", "own"] = Field(
        "stage",
        description="stage: that of the surveyed lights; own: any other, which mirror-ball images then lay over the "
        "stage's by turning and shifting it",
    )
