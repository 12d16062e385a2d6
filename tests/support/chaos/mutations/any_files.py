"""Changes to a file of any kind: what disks, copies and archives do to it."""

from __future__ import annotations

import os
import random
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from tests.support.chaos.mutations.mutation import Meaning, Mutation, remove, replace

BROKEN, SAME = Meaning.BROKEN, Meaning.SAME


def mutations(name: str, rng: random.Random) -> Iterator[Mutation]:
    """Changes to a file that every reader has to notice.

    Args:
        name: of the file, relative to the capture.
        rng: draws what is random of the changes.
    """
    noise = rng.randbytes(300)
    share = rng.uniform(0.1, 0.95)
    yield Mutation(name, "removed", BROKEN, lambda root: remove(root / name))
    yield Mutation(name, "empty", BROKEN, lambda root: replace(root / name, b""))
    yield Mutation(name, "noise", BROKEN, lambda root: replace(root / name, noise))
    yield Mutation(name, "cut off", BROKEN, partial(_cut, name, share))
    yield Mutation(name, "a folder", BROKEN, partial(_folder, name))
    yield Mutation(name, "a link that dangles", BROKEN, partial(_link, name, "nothing"))
    yield Mutation(name, "a link to itself", BROKEN, partial(_link, name, Path(name).name))
    yield Mutation(name, "a link out of the capture", BROKEN, partial(_link, name, "/etc/hostname"))
    yield Mutation(name, "a link to a device", BROKEN, partial(_link, name, "/dev/zero"))
    yield Mutation(name, "a pipe", BROKEN, partial(_pipe, name))
    yield Mutation(name, "a link within the capture", SAME, partial(_moved_behind_link, name))


def _cut(name: str, share: float, root: Path) -> None:
    content = (root / name).read_bytes()
    replace(root / name, content[: int(len(content) * share)])


def _folder(name: str, root: Path) -> None:
    remove(root / name)
    (root / name).mkdir()


def _link(name: str, target: str, root: Path) -> None:
    remove(root / name)
    (root / name).symlink_to(target)


def _pipe(name: str, root: Path) -> None:
    remove(root / name)
    os.mkfifo(root / name)


def _moved_behind_link(name: str, root: Path) -> None:
    moved = root / f"moved_{Path(name).name}"
    (root / name).rename(moved)
    (root / name).symlink_to(moved)
