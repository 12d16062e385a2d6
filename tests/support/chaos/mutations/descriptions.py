"""Changes to capture.yaml: its text, and each of its keys."""

from __future__ import annotations

import copy
import random
import re
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import yaml

from tests.support.chaos.mutations.mutation import Meaning, Mutation, replace

FILE = "capture.yaml"
BROKEN, SAME, OTHER = Meaning.BROKEN, Meaning.SAME, Meaning.OTHER

NEVER = {
    "null": None, "a list": [1, "a"], "a section": {"a": 1}, "no text": "", "a long text": "x" * 5000,
    "a huge number": 10**400, "minus one": -1, "not a number": float("nan"), "infinity": float("inf"),
    "control letters": "a\x07\x1b[31m", "a path out": "../../etc/passwd", "an absolute path": "/dev/zero",
    "nested deep": [[[[[[[[[[1]]]]]]]]]], "braces": "{camera}/{frame!r:{frame}}", "a template": "{0.__class__}",
    "one flag": "--help", "a name of 300 letters": "n" * 300, "a number as text": "12 apples",
}  # fmt: skip
"""Values that no key of capture.yaml takes, but for those of `TAKEN`."""

TAKEN = {
    ("subject", "a name of 300 letters"), ("calibration", "a section"), ("masks", "null"), ("keypoints_2d", "null"),
    ("validation_cameras", "null"), ("validation_frames", "null"), ("validation_patterns", "null"),
}  # fmt: skip
"""Keys and values that the format allows, or that leave the default."""

TEXTS: dict[str, tuple[Meaning, Callable[[str], str | bytes]]] = {
    "lines end as on Windows": (SAME, lambda text: text.replace("\n", "\r\n").encode()),
    "a byte order mark": (SAME, lambda text: b"\xef\xbb\xbf" + text.encode()),
    "a comment of all kinds of letters": (SAME, lambda text: f"# Ωmega 写真 \U0001f600\n{text}"),
    "a document mark": (SAME, lambda text: f"---\n{text}"),
    "as JSON": (SAME, lambda text: yaml.safe_dump(yaml.safe_load(text), default_flow_style=True)),
    "sorted": (SAME, lambda text: yaml.safe_dump(yaml.safe_load(text), sort_keys=True)),
    "numbers with exponents": (SAME, lambda text: re.sub(r"(?m)^fps: .*$", "fps: 1.2e+1", text)),
    "in UTF-16": (BROKEN, lambda text: text.encode("utf-16")),
    "letters of Latin-1": (BROKEN, lambda text: text.encode() + "# café".encode("latin-1")),
    "a zero byte": (BROKEN, lambda text: text.replace(":", ":\0", 1)),
    "tabs": (BROKEN, lambda text: text.replace("  ", "\t")),
    "two documents": (BROKEN, lambda text: f"{text}---\n{text}"),
    "a key twice": (BROKEN, lambda text: f"{text}fps: 24\n"),
    "a month 13": (BROKEN, lambda text: f"{text}recorded: 2026-13-01\n"),
    "a date as a key": (BROKEN, lambda text: f"{text}2026-01-01: 1\n"),
    "a number as a key": (BROKEN, lambda text: f"{text}1: 1\n"),
    "a list as a key": (BROKEN, lambda text: f"{text}? [a, b]\n: 1\n"),
    "an object of Python": (BROKEN, lambda text: f"{text}x: !!python/object/apply:os.system ['true']\n"),
    "a wrong tag": (BROKEN, lambda text: f"{text}x: !!int nothing\n"),
    "five thousand digits": (BROKEN, lambda text: f"{text}x: {'9' * 5000}\n"),
    "3,000 levels": (BROKEN, lambda text: f"{text}x: {'[' * 3000}{']' * 3000}\n"),
    "an alias of nothing": (BROKEN, lambda text: f"{text}x: *nothing\n"),
    "an alias of itself": (BROKEN, lambda text: f"{text}x: &a [*a]\n"),
    "a billion laughs": (BROKEN, lambda text: text + laughs()),
    "20,000 keys": (BROKEN, lambda text: text + "".join(f"k{number}: 1\n" for number in range(20_000))),
    "a merge of nothing": (BROKEN, lambda text: f"{text}<<: 3\n"),
    "only a list": (BROKEN, lambda text: "- a\n"),
    "only text": (BROKEN, lambda text: "capture\n"),
    "only a comment": (BROKEN, lambda text: "# nothing\n"),
}  # fmt: skip


def laughs() -> str:
    """Eight levels of ten aliases each."""
    lines = ["l0: &l0 [ha, ha, ha, ha, ha, ha, ha, ha, ha, ha]"]
    lines += [f"l{level}: &l{level} [{', '.join([f'*l{level - 1}'] * 10)}]" for level in range(1, 9)]
    return "\n".join(lines) + "\n"


def mutations(content: dict[str, Any], rng: random.Random) -> Iterator[Mutation]:
    """Changes to the text, and for each key: taken away, spelt otherwise, and values that it never takes."""
    for what, (meaning, change) in TEXTS.items():
        yield Mutation(FILE, what, meaning, partial(_change_text, change))
    for path in leaves(content):
        key = ".".join(path)
        optional = path[0] in ("masks", "keypoints_2d") or path[-1] in ("black_level", "test_patterns", "scale_to_m")
        optional = optional or path[-1].startswith("validation_") or path[0] == "calibration"
        yield _key(f"{key} is gone", OTHER if optional else BROKEN, path, _delete)
        yield _key(f"{key} is misspelt", BROKEN, path, _misspell)
        yield _key(f"{key} beside an unknown key", BROKEN, path, _add_unknown)
        for what, value in NEVER.items():
            if (path[-1], what) in TAKEN or (what == "minus one" and path[-1] == "black_level"):
                continue
            yield _key(f"{key} is {what}", BROKEN, path, partial(_set, value))
        if isinstance(value := dig(content, path), (int, float)) and not isinstance(value, bool):
            factor = rng.choice([1e-3, 10.0, 1e3])
            yield _key(f"{key} times {factor:g}", scaled_meaning(path, value), path, partial(_scale, factor))


def scaled_meaning(path: tuple[str, ...], value: float) -> Meaning:
    """A number in another unit is wrong; nothing stays nothing."""
    return SAME if value == 0 else BROKEN


def leaves(content: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Paths of all keys, sections included."""
    for key, value in content.items():
        yield (*path, key)
        if isinstance(value, dict):
            yield from leaves(value, (*path, key))


def dig(content: dict[str, Any], path: tuple[str, ...]) -> Any:
    for key in path:
        content = content[key]
    return content


def _key(what: str, meaning: Meaning, path: tuple[str, ...], change: Callable[[dict, str], None]) -> Mutation:
    def apply(root: Path) -> None:
        content = copy.deepcopy(yaml.safe_load((root / FILE).read_text()))
        change(dig(content, path[:-1]), path[-1])
        replace(root / FILE, yaml.safe_dump(content, sort_keys=False, allow_unicode=True))

    return Mutation(FILE, what, meaning, apply)


def _change_text(change: Callable[[str], str | bytes], root: Path) -> None:
    replace(root / FILE, change((root / FILE).read_text()))


def _delete(section: dict, key: str) -> None:
    del section[key]


def _misspell(section: dict, key: str) -> None:
    section[f"{key[:-1]}q"] = section.pop(key)


def _add_unknown(section: dict, key: str) -> None:
    section[f"{key}_too"] = section[key]


def _set(value: Any, section: dict, key: str) -> None:
    section[key] = value


def _scale(factor: float, section: dict, key: str) -> None:
    section[key] = type(section[key])(section[key] * factor)
