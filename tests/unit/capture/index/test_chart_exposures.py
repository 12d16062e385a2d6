"""The table of exposures: what of it reaches the index, and what is complained about."""

from __future__ import annotations

import pytest

from pipeline.base.errors import Complaints, InputError
from pipeline.capture.index.color_files import read_exposures_csv

PATH = "exposures.csv"


def read(folder, *rows):
    (folder / PATH).write_text("\n".join(["camera,path,exposure_s", *rows]) + "\n")
    complaints = Complaints(folder)
    found = read_exposures_csv(folder, PATH, ["cam0", "cam1"], complaints)
    complaints.raise_if_any()
    return found


def test_each_row_is_an_image_with_its_time(tmp_path):
    found = read(tmp_path, "cam1,a.tif,0.01", "cam1,b.tif,0.02")
    assert found == [
        {"camera": "cam1", "path": "a.tif", "exposure_s": 0.01}, {"camera": "cam1", "path": "b.tif", "exposure_s": 0.02}
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("rows", "complaint"),
    [
        (("cam1,a.tif,0", "cam1,b.tif,0.02"), "more than 0 seconds"),
        (("cam1,a.tif,0.01", "cam1,b.tif,0.01"), "cam1: exposure_s: expected at least 2 exposure times, found 1"),
        (("cam7,a.tif,0.01", "cam7,b.tif,0.02"), "cam7"),
        (("cam0,a.tif,0.01", "cam0,a.tif,0.02"), "a.tif"),
    ],
    ids=["no time", "one time", "no such camera", "one image twice"],
)
def test_what_is_wrong_is_named(tmp_path, rows, complaint):
    with pytest.raises(InputError, match=complaint):
        read(tmp_path, *rows)
