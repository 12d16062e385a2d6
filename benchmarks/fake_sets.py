"""Fakes of public sets that are measured, each with its truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from tests.support.datasets import (
    actorshq_layout,
    ava256_layout,
    becominglit_layout,
    faceolat_layout,
    goliath_kinds_layout,
    goliath_layout,
    humanolat_layout,
    nersemble_layout,
    olatverse_layout,
    openillumination_layout,
)
from tests.support.datasets.turning_head import TurningHead


@dataclass(frozen=True)
class FakeSet:
    """A fake of one set.

    Attributes:
        dataset: the set, as the configuration names it.
        truth: makes the truth; `image` is width and height of its images.
        write: writes it in the set's layout below a folder; returns the folder that `path` names.
        cameras: number of those with images.
        true_frame: the truth's frame by the imported capture's.
        settings: of import_capture, as YAML; may write files that they name into the folder.
        constant_light: True if the set does not say where light comes from.
        image: width and height of its images.
        part: word that tells it from other fakes of its set; empty: none.
    """

    dataset: str
    truth: Callable[..., TurningHead]
    write: Callable[[Path, TurningHead], Path]
    cameras: int
    true_frame: Callable[[int], int] = int
    settings: Callable[[Path, TurningHead], str] = lambda folder, truth: "{}"
    constant_light: bool = False
    image: tuple[int, int] = (96, 144)
    part: str = ""

    @property
    def name(self) -> str:
        """Name of the fake, and of the subject that it becomes."""
        return f"{self.dataset}_{self.part}" if self.part else self.dataset


def true_frame_of(sequences: Mapping[str, range]) -> Callable[[int], int]:
    """The truth's frame by the imported one: sequences count from 0, and the kth from 100000 k here."""
    spans = sorted(sequences.values(), key=lambda span: span[0])
    return lambda frame: spans[frame // 100_000][frame % 100_000]


FAKES = (
    FakeSet(
        "goliath", goliath_layout.true_head, goliath_layout.write_goliath,
        len(goliath_layout.CAMERAS),
    ),
    FakeSet(
        "goliath", goliath_kinds_layout.true_hand, goliath_kinds_layout.write_hands,
        len(goliath_kinds_layout.CAMERAS), part="hand",
    ),
    FakeSet(
        "goliath", goliath_kinds_layout.true_body, goliath_kinds_layout.write_body,
        len(goliath_kinds_layout.CAMERAS), constant_light=True, part="body",
    ),
    FakeSet(
        "becominglit", becominglit_layout.true_head, becominglit_layout.write_becominglit,
        len(becominglit_layout.CAMERAS), true_frame_of(becominglit_layout.SEQUENCES),
    ),
    FakeSet(
        "humanolat", humanolat_layout.true_head, humanolat_layout.write_humanolat,
        len(humanolat_layout.CAMERAS),
    ),
    FakeSet(
        "openillumination", openillumination_layout.true_object,
        openillumination_layout.write_openillumination, len(openillumination_layout.CAMERAS),
    ),
    FakeSet(
        "olatverse", olatverse_layout.true_object, olatverse_layout.write_olatverse,
        len(olatverse_layout.CAMERAS),
    ),
    FakeSet(
        "faceolat", faceolat_layout.true_head, faceolat_layout.write_faceolat,
        len(faceolat_layout.CAMERAS), lambda frame: frame - 1,
        faceolat_layout.settings,
    ),
    FakeSet(
        "ava256", ava256_layout.true_head, ava256_layout.write_ava256,
        len(ava256_layout.CAMERAS), settings=ava256_layout.settings, constant_light=True,
    ),
    FakeSet(
        "actorshq", actorshq_layout.true_head, actorshq_layout.write_actorshq,
        len(actorshq_layout.CAMERAS), settings=actorshq_layout.settings, constant_light=True,
        image=(108, 144),
    ),
    FakeSet(
        "nersemble", nersemble_layout.true_head, nersemble_layout.write_nersemble,
        len(nersemble_layout.CAMERAS), true_frame_of(nersemble_layout.SEQUENCES), nersemble_layout.settings,
        constant_light=True, image=(96, 140),
    ),
)  # fmt: skip
