"""Subject whose stages dials run: its files, and how a stage is called on them."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pipeline.config.flags import flags
from pipeline.config.project import SECTIONS
from pipeline.config.stage_commands import THREADED, Value, stage_arguments, subject_files

CHUNK = "0000"
"""The chunk of frames on which stages that work chunk by chunk are measured."""

NOT_HANDED_OVER: dict[str, Value] = dict.fromkeys(
    ("frame_shards", "visibility", "environment", "light_list", "captured"), ()
)
"""What a stage does without unless a dial says where it is: all avatars have the shards' own frames, and visibility
that an earlier run kept would make a later one look fast."""


@dataclass(frozen=True)
class Subject:
    """Files of a subject, and how its stages are run.

    Attributes:
        results: folder results/<subject>, filled by the workflow.
        capture: folder of the capture; `capture`/truth is there if it was synthesised.
        threads: that stages may use.
        chunk_size: frames per chunk.
        sections: stage -> settings that differ from the defaults.
        made: folder for what dials make for themselves, see `CostedStage.makes`.
        variant: the avatar that is relit.
    """

    results: Path
    capture: Path
    threads: int
    chunk_size: int
    sections: Mapping[str, Mapping[str, Any]]
    made: Path = Path("made")
    variant: str = "full"

    def named(self) -> dict[str, Value]:
        """Files and facts by the names of `pipeline.config.stage_commands`."""
        facts = {"capture": str(self.capture), "subject": self.results.name, "chunk_size": str(self.chunk_size)}
        one = {"chunk": CHUNK, "variant": self.variant}
        files = subject_files(self.results, **one)
        estimated = {"gaze": files["estimated_gaze"]} if Path(files["estimated_gaze"]).exists() else {}
        return {**files, **facts, **one, **estimated, **NOT_HANDED_OVER}

    def has(self, part: Literal["head", "eyes"]) -> bool:
        """True if the workflow made what only avatars of heads, or of eyes, read."""
        return (self.results / {"head": "textures", "eyes": "eyes.json"}[part]).exists()

    def command_line(self, stage: str, change: Mapping[str, Any], files: Mapping[str, Value]) -> list[str]:
        """Command line of a stage, with the subject's settings but for `change`.

        Args:
            files: those that are elsewhere than in the subject's results.
        """
        settings = SECTIONS[stage](**{**self.sections.get(stage, {}), **change})
        lacking = {name: () for part, name in (("head", "textures"), ("eyes", "eyes")) if not self.has(part)}
        words = stage_arguments(stage, {**self.named(), **files, **lacking})
        threads = ["--threads", str(self.threads)] if stage in THREADED else []
        return [sys.executable, "-m", f"pipeline.stages.{stage}", *words, *threads, *flags(settings)]
