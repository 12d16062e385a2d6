"""Read a capture of a public set in place and describe it in the native format.

Images, masks and meshes stay where the set has them, in their archives: the capture has a link to the set's folder.
What the set gives is taken: cameras, lights, patterns, colours, masks, meshes, head poses, splits; what it lacks is
computed by the usual stages. Where each comes from is noted in capture.yaml and shown on the report. What is read has
to agree with itself: the meshes are projected into the masks.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.config.import_capture import ImportCapture
from pipeline.datasets.actorshq import read_actorshq
from pipeline.datasets.ava256 import read_ava256
from pipeline.datasets.becominglit import read_becominglit
from pipeline.datasets.faceolat import read_faceolat
from pipeline.datasets.goliath import read_goliath
from pipeline.datasets.humanolat import read_humanolat
from pipeline.datasets.imported_capture import ImportedCapture
from pipeline.datasets.native import write_native
from pipeline.datasets.nersemble import read_nersemble
from pipeline.datasets.olatverse import read_olatverse
from pipeline.datasets.openillumination import read_openillumination
from pipeline.datasets.reduced_capture import reduced

log = logging.getLogger("import_capture")

READERS: dict[str, Callable[[Path, ImportCapture], ImportedCapture]] = {
    "goliath": read_goliath,
    "becominglit": read_becominglit,
    "humanolat": read_humanolat,
    "openillumination": read_openillumination,
    "olatverse": read_olatverse,
    "faceolat": read_faceolat,
    "ava256": read_ava256,
    "actorshq": read_actorshq,
    "nersemble": read_nersemble,
}
"""Reader of each set of `pipeline.config.datasets.DATASETS`."""


def run(*, dataset: str, source: Path, subject: str, out: Path, settings: ImportCapture = ImportCapture()) -> None:
    """Read one capture of a public set and write its native description.

    Args:
        dataset: the set, as `source` of the configuration names it.
        source: folder of the capture, as the set ships it; nothing is written there.
        subject: what the capture is called here.
        out: capture folder to write: capture.yaml, tables, cameras, the template and a link to `source`.
        settings: what is taken of the set.
    """
    if dataset not in READERS:
        raise InputError(f"--dataset: expected one of {', '.join(READERS)}, found {dataset!r}")
    if not source.is_dir():
        raise InputError(f"--source: expected the folder of a {dataset} capture, found none: {source}")
    found = reduced(READERS[dataset](source.resolve(), settings), settings.reduced)
    write_native(out, source, dataset, subject, found)
    for word, notes in vars(found.provenance).items():
        for what, how in notes.items():
            level = logging.WARNING if word == "assumed" else logging.INFO
            log.log(level, "%s: %s: %s", word.replace("_", " "), what, how)
    images = found.images.table
    log.info("%d images of %d cameras, %d frames", len(images), len(found.cameras), len(found.frames))


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
