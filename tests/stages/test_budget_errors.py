"""Inputs with the truth in their place, and the stage that trains on them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays, read_json, read_table, write_arrays, write_json, write_table
from pipeline.config.budget_errors import RETRAINED_STAGES, BudgetErrors
from pipeline.dials.subject import Subject
from pipeline.dials.true_inputs import TRUTH, Inputs
from pipeline.figures.style import GRADE_COLORS
from pipeline.geometry.cameras import Camera, read_cameras, write_cameras
from pipeline.stages import budget_errors
from tests.support.figures.kept_figures import bars, kept_figures

TURN, SHIFT = Rotation.from_rotvec([0.02, -0.01, 0.03]).as_matrix(), np.array([0.01, -0.02, 0.005])
"""True frame from the found one: x_true = TURN x + SHIFT."""

NEAR_M = 2e-6
"""Of metres in float32 files."""

PARTS = tuple(TRUTH)


def looking_at_middle(center: np.ndarray) -> Camera:
    forward = -center / np.linalg.norm(center)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    K = np.array([[200.0, 0, 50], [0, 200, 60], [0, 0, 1]])
    return Camera(R, -R @ center, K, np.zeros(5), 100, 120)


@pytest.fixture
def subject(tmp_path: Path) -> Subject:
    """Results that are the truth in another frame, but for focal lengths, one light and a colour."""
    results, capture, random = tmp_path / "results/s", tmp_path / "captures/s", np.random.default_rng(0)
    true = {f"c{n}": looking_at_middle(random.normal(size=3) + np.array([0, 0, 3.0])) for n in range(5)}
    found = {
        name: replace(c, R=c.R @ TURN, t=c.R @ SHIFT + c.t, K=c.K @ np.diag([1.1, 1.1, 1])) for name, c in true.items()
    }
    write_cameras(capture / "truth/cameras.json", true)
    write_cameras(results / "calibration/cameras.json", found)
    lights, vertices = random.normal(size=(6, 3)), random.normal(size=(2, 7, 3)).astype(np.float32)
    names = [f"l{n}" for n in range(6)]
    write_table(capture / "truth/lights.parquet", pd.DataFrame(lights, columns=["x", "y", "z"]).assign(light=names))
    own = pd.DataFrame((lights - SHIFT) @ TURN + 0.1, columns=["x", "y", "z"]).assign(light=names, intensity=2.0)
    write_table(results / "calibration/lights.parquet", own.iloc[::-1])
    frames = np.array([3, 8])
    write_arrays(capture / "truth/tracking.safetensors", {"frames": frames[::-1].copy(), "vertices": vertices})
    wrong = {"frames": frames, "vertices": np.zeros_like(vertices), "offsets": vertices}
    write_arrays(results / "tracking/0000.safetensors", wrong)
    gains = {name: np.diag([1.0, 2.0, 0.5]).tolist() for name in true}
    write_json(capture / "truth/color.json", {"raw_from_true": gains})
    write_json(results / "calibration/color.json", {"cameras": dict.fromkeys(true, np.eye(3).tolist()), "note": "kept"})
    write_table(results / "frames.parquet", pd.DataFrame({"frame": frames}))
    return Subject(results, capture, 1, 64, {})


def test_true_inputs_lie_in_the_found_frame(subject, tmp_path):
    inputs = Inputs.of(subject)
    written = {part: inputs.write(part, tmp_path / "true") for part in PARTS}
    true = read_arrays(subject.capture / "truth/tracking.safetensors")["vertices"]
    tracked = read_arrays(written["tracking"])
    expected = (true[::-1].astype(np.float64) - SHIFT) @ TURN  # the truth lists its frames the other way round
    np.testing.assert_allclose(tracked["vertices"], expected, atol=NEAR_M)
    np.testing.assert_array_equal(tracked["offsets"], true)
    lights = read_table(written["lights"]).set_index("light")
    wanted = read_table(subject.capture / "truth/lights.parquet").set_index("light").loc[lights.index]
    np.testing.assert_allclose(lights[["x", "y", "z"]] @ TURN.T + SHIFT, wanted[["x", "y", "z"]], atol=NEAR_M)
    assert (lights.intensity == 2.0).all()
    assert read_json(written["color"]) == {
        "cameras": dict.fromkeys(cameras_of(subject), np.diag([1.0, 0.5, 2.0]).tolist()), "note": "kept"
    }  # fmt: skip


def cameras_of(subject: Subject) -> list[str]:
    return list(read_cameras(subject.results / "calibration/cameras.json"))


def test_a_point_is_seen_where_it_truly_is(subject, tmp_path):
    """By the true cameras in the found frame: the true lenses, and the point brought to that frame."""
    inputs, point = Inputs.of(subject), np.array([[0.1, -0.2, 0.3]])
    moved = read_cameras(inputs.write("cameras", tmp_path))
    for name, true in read_cameras(subject.capture / "truth/cameras.json").items():
        np.testing.assert_allclose(moved[name].project(inputs.brought(point))[0], true.project(point)[0], atol=1e-6)


class TestStage:
    """With a list of commands in place of the stages."""

    @pytest.fixture
    def started(self, monkeypatch):
        started = []

        class Done:
            def require_success(self):
                return self

        def run_measured(command):
            words = command[command.index("-m") + 1 :]
            started.append(words)
            if words[0].endswith("evaluate_avatar"):
                folder = Path(words[words.index("--out") + 1])
                true = len(list((folder / "true").glob("*")))
                rows = [("validation", "all"), ("test", "all"), ("test", "full"), ("test", "partial")]
                table = pd.DataFrame(rows, columns=["split", "lit"]).assign(psnr_db=30.0 + true)
                write_table(folder / "metrics.csv", table)
            return Done()

        monkeypatch.setattr(budget_errors, "run_measured", run_measured)
        return started

    def test_one_part_after_the_other_becomes_ours(self, subject, tmp_path, started):
        with kept_figures() as figures:
            budget_errors.run(results=subject.results, capture=subject.capture, out=tmp_path / "out")
        table = pd.read_csv(tmp_path / "out/error_budget.csv", keep_default_na=False)
        assert table.step.tolist() == ["all true", "our color", "our lights", "our cameras", "our tracking"]
        assert table.true.tolist()[1:4] == ["lights cameras tracking", "cameras tracking", "tracking"]
        assert table.test_all_db.tolist() == [34, 33, 32, 31, 30]
        (axes,) = figures["error_budget.png"].axes
        first, *others = bars(axes)
        assert first[0] + first[1] == 34  # what true inputs score
        assert others == [(before, -1, GRADE_COLORS["failed"]) for before in (34, 33, 32, 31)]
        assert [label.get_text() for label in axes.get_yticklabels()] == table.step.tolist()
        stages = [words[0].rpartition(".")[2] for words in started]
        assert stages == 5 * list(RETRAINED_STAGES)
        cameras = [words[words.index("--cameras") + 1] for words in started[::3]]
        ours = str(subject.results / "calibration/cameras.json")
        assert [path == ours for path in cameras] == [False, False, False, True, True]

    def test_without_a_truth_it_says_what_is_missing(self, subject, tmp_path, started):
        (subject.capture / "truth/color.json").unlink()
        (subject.capture / "truth/cameras.json").unlink()
        with pytest.raises(InputError) as error:
            budget_errors.run(
                results=subject.results, capture=subject.capture, out=tmp_path / "out",
                settings=BudgetErrors(parts=("color",)),
            )  # fmt: skip
        assert "color.json: expected the truth" in str(error.value) and "cameras.json: expected" in str(error.value)
        assert not started and not (tmp_path / "out").exists()
