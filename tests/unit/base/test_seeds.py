from __future__ import annotations

import subprocess
import sys

import numpy as np

from pipeline.base.seeds import generator_for, seed_for


def test_seed_is_the_same_in_another_process_whatever_its_hash_seed() -> None:
    code = "from pipeline.base.seeds import seed_for; print(seed_for('walker', 'train_avatar', 7))"
    for hash_seed in ("1", "2"):
        environment = {"PYTHONHASHSEED": hash_seed, "PYTHONPATH": ":".join(path for path in sys.path if path)}
        found = subprocess.run(
            [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
        )
        assert int(found.stdout) == seed_for("walker", "train_avatar", 7)


def test_seeds_differ_by_every_part_and_by_their_bounds() -> None:
    parts = [("a", "b", 1), ("a", "b", 2), ("a", "c", 1), ("ab", "", 1), ("a", "b1"), ("a", "b", 1, "")]
    assert len({seed_for(*part) for part in parts}) == len(parts)


def test_seed_fits_a_signed_64_bit_integer() -> None:
    seeds = [seed_for("subject", frame) for frame in range(1000)]
    assert min(seeds) >= 0
    assert max(seeds) < 2**63
    # 1000 uniform numbers: all below half the range with probability 2^-1000.
    assert max(seeds) > 2**62


def test_generators_repeat_and_are_independent() -> None:
    draws = generator_for("s", "stage", 1).normal(size=4000)
    np.testing.assert_array_equal(draws, generator_for("s", "stage", 1).normal(size=4000))
    other = generator_for("s", "stage", 2).normal(size=4000)
    # The correlation of independent draws has deviation 1 / sqrt(4000) = 0.016; six of them.
    assert abs(np.corrcoef(draws, other)[0, 1]) < 0.1
