"""The page "Where the time goes": its tables from small inputs, and what its benchmarks attribute and count."""

import json
import time
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from benchmarks.bench_training_parts import array_bytes, table
from benchmarks.limit_jobs import count_strips
from benchmarks.training_ranges import MARKED, REST, SUMMED, Part, marked, seconds_of_parts, within
from docs.generate.where_time_goes import run
from pipeline.base.errors import InputError
from pipeline.rendering.projection_kernels import FOOTPRINT_COLUMNS, TILE

STEP = {
    "subject": "one", "steps": 20, "texels": 1000, "cameras_per_step": 2, "s": 0.5, "cpu_s": 0.2,
    "parts": [{"part": "Adam", "forward_s": 0.05, "backward_s": 0.0},
              {"part": "blending", "forward_s": 0.05, "backward_s": 0.1}],
    "frames_held": 7, "bytes_of_a_frame": {"record.vertices": 36, "posed.points": 12000},
}  # fmt: skip

LIMITS = {
    "processor": "Abacus", "repeats": 3, "operations_per_s": 2e9, "bytes_per_s": 1e9, "roofs": [],
    "kernels": [{"what": "sums", "size": "a row", "cpu_s": 2.0, "operations": 2e9, "bytes": 1e8},
                {"what": "copies", "size": "a row", "cpu_s": 2.0, "operations": 2e8, "bytes": 1.5e9}],
    "twins": [{"what": "tracing", "limit": "rays alone", "size": "a ball", "unit": "rays", "count": 3e6, "cpu_s": 2.0,
               "bare_cpu_s": 1.5}],
}  # fmt: skip

JOBS = {
    "track_mesh.0000": "75\t100\t30",
    "track_mesh.0001": "15\t200\t20",
    "index_capture": "10\t50\t10",
    "train_avatar.full": "45\t300\t38",
    "train_avatar.plain": "0.5\tNA\t2",
    "measure_cost": "900\t999\t900",
}
"""Name of a file -> seconds, memory and processor seconds, which end as Snakemake looks at them."""


@pytest.fixture
def page(tmp_path):
    """The page of the subject `one`, from made-up measurements."""
    folder, measured, written = tmp_path / "one/benchmarks", tmp_path / "time", tmp_path / "page.md"
    folder.mkdir(parents=True)
    measured.mkdir()
    for job, numbers in JOBS.items():
        (folder / f"{job}.tsv").write_text(f"s\tmax_rss\tcpu_time\n{numbers}\n")
    (measured / "training_one.json").write_text(json.dumps(STEP))
    (measured / "limits.json").write_text(json.dumps(LIMITS))
    run(results=(tmp_path / "one",), measured=measured, page=written)
    return written.read_text()


def test_chunks_of_a_stage_are_summed_and_the_largest_memory_is_kept(page):
    rows = [line for line in page.splitlines() if line.startswith(("| `", "| all | 5"))]
    assert rows[:5] == [
        "| `index_capture` | 1 | 10.0 | 10.0 | 10 % | 50 |",
        "| `track_mesh` | 2 | 90.0 | 50.0 | 50 % | 200 |",
        "| `train_avatar` full | 1 | 45.0 | 38.0 | 38 % | 300 |",
        "| `train_avatar` plain | 1 | 0.500 | 2.00 | 2.0 % | – |",
        "| all | 5 | 146 | 100 | 100 % | 300 |",
    ]


def test_parts_of_a_step_are_listed_by_size_with_their_shares(page):
    assert "A step of 2 images on 1,000 texels: 200 ms of CPU time, the mean of 20." in page
    assert "| blending | 50.0 | 100 | 75 % |\n| Adam | 50.0 | – | 25 % |\n" in page


def test_bytes_of_a_frame_are_listed_and_summed(page):
    assert "| `posed.points` | 12,000 | 12.0 |\n| `record.vertices` | 36 | 0.036 |\n| all | 12,036 | 12.0 |\n" in page


def test_kernels_are_bound_by_the_slower_of_operations_and_memory(page):
    assert "Abacus: 2 billion operations and 1 GB a second." in page
    assert "| sums | a row | 2,000 | 1.00 | 0.050 | operations | 1,000 | 50 % |" in page
    assert "| copies | a row | 2,000 | 0.100 | 0.750 | memory | 1,500 | 75 % |" in page


def test_jobs_stand_beside_the_rate_of_the_library_alone(page):
    assert "| tracing | a ball | million rays/s | 1.50 | 2.00 (rays alone) | 75 % |" in page


def test_folder_without_measurements_is_refused(tmp_path):
    with pytest.raises(InputError, match="make time"):
        run(results=(), measured=tmp_path, page=tmp_path / "page.md")


class Slow(torch.autograd.Function):
    """The identity, which sleeps on the way back."""

    @staticmethod
    def forward(ctx, x):
        return x.clone()

    @staticmethod
    def backward(ctx, grad):
        time.sleep(0.05)
        return grad


def test_backward_time_belongs_to_the_range_of_its_forward_pass():
    x = torch.ones(3, requires_grad=True)
    adam = torch.optim.Adam([x])
    first = within("part: first", lambda y: (time.sleep(0.02), Slow.apply(y))[1])
    second = within("part: second", lambda y: within("part: kernel", torch.exp)(y) * 2)
    with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CPU]) as profiler:
        second(first(x)).sum().backward()
        adam.step()
    seconds = seconds_of_parts(profiler.events())
    assert seconds[Part("first", True)] >= 0.05 and seconds[Part("first", False)] >= 0.02
    names = {(part.name, part.backward) for part in seconds}
    assert names >= {("second", True), ("kernel", True), ("kernel", False), ("Adam", False), (SUMMED, True)}


def event(name, start, sequence_nr=-1, inside=None, seconds=0.0):
    """One of a profile, as far as it is looked at; it takes its seconds besides what runs in it."""
    span = SimpleNamespace(start=start)
    return SimpleNamespace(
        name=name, time_range=span, sequence_nr=sequence_nr, cpu_parent=inside, self_cpu_time_total=1e6 * seconds
    )


def test_number_that_operations_share_belongs_to_the_last_that_bears_it():
    """An operation without gradient runs in `a` and leaves its number to the first one of `b`."""
    a, b = event("part: a", 0, seconds=1), event("part: b", 2, seconds=2)
    node = event("autograd::engine::evaluate_function: MulBackward0", 9, 7, seconds=4)
    events = [a, event("aten::nonzero", 1, 7, a, 8), b, event("aten::mul", 3, 7, b, 16),
              node, event("aten::mul", 10, 5, node, 32), event("Optimizer.step#Adam.step", 11, seconds=64)]  # fmt: skip
    assert seconds_of_parts(events) == {
        Part("a", False): 9, Part("b", False): 18, Part("b", True): 36, Part("Adam", False): 64
    }  # fmt: skip


def test_marks_are_put_on_functions_that_exist_and_taken_off_again():
    before = [getattr(owner, name) for owner, name, _ in MARKED]
    with marked():
        assert all(getattr(owner, name) is not own for (owner, name, _), own in zip(MARKED, before, strict=True))
    assert [getattr(owner, name) for owner, name, _ in MARKED] == before


def test_profile_is_spread_over_the_time_of_a_step_nobody_looked_at():
    rows = table({Part("a", False): 1.0, Part("a", True): 2.0, Part(REST, False): 0.5}, whole_s=4.0, cpu_s=0.4)
    assert rows == [
        {"part": "a", "forward_s": pytest.approx(0.1), "backward_s": pytest.approx(0.2)},
        {"part": REST, "forward_s": pytest.approx(0.1), "backward_s": 0.0},
    ]


def test_bytes_are_found_within_tuples_dictionaries_and_objects():
    held = {"lights": (torch.zeros(2, 3), np.zeros(5)), "name": "one", "posed": SimpleNamespace(points=torch.zeros(9))}
    assert array_bytes(held) == {"lights.0": 24, "lights.1": 40}


@pytest.mark.parametrize(("ends", "forward", "backward"), [(5, 5, 5), (2, 3, 2)])
def test_strips_of_opaque_rows_end_one_gaussian_later_forward(ends, forward, backward):
    """Five footprints over all of two tiles; in the first one, each pixel's list ends at `ends`."""
    footprints = np.zeros((5, FOOTPRINT_COLUMNS))
    footprints[:] = [TILE, TILE / 2, 1e-3, 0, 1e-3, 0.5, 1.0, 100.0]
    starts, entries = np.array([0, 5, 10]), np.array([*range(5), *range(5)], np.int32)
    image = np.full((TILE, 2 * TILE), 5, np.int32)
    image[:, :TILE] = ends
    found = count_strips(footprints, starts, entries, 2, image)
    assert found == (TILE * (forward + 5), TILE * (backward + 5))
