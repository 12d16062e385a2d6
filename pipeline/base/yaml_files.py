"""Reading YAML that people write; what is wrong with it is an `InputError`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from pipeline.base.errors import InputError

MOST_LEVELS = 50
"""Levels of nesting that are read: ten times what any file of this project has. libyaml's composer calls itself for
each, and ends the process when its stack is full."""

MOST_VALUES = 1_000_000
"""Values that are read, each alias counted as what it stands for: a hundred times any table that people write. Eight
lines of ten aliases each stand for a hundred million, which nobody could check or print."""

MERGE = "tag:yaml.org,2002:merge"
"""Tag of the key `<<`, which stands for the keys of another mapping."""


class _PlainKeyLoader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
    """Keys are text, each once: YAML itself lets the last of two equal keys win without a word.

    libyaml's parser, where PyYAML was built with it, takes a fifth of the time.
    """

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        seen = set()
        for key_node, _ in node.value:
            if key_node.tag == MERGE:
                continue
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, str):
                found = f"expected text as a key, found {key!r}; put it in quotes"
                raise yaml.constructor.ConstructorError(None, None, found, key_node.start_mark)
            if key in seen:
                found = f"the key {key!r} is there twice"
                raise yaml.constructor.ConstructorError(None, None, found, key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep)


def read_yaml(path: Path) -> Any:
    """Content of a YAML file in UTF-8; None if it is empty.

    Raises:
        InputError: if it is no plain file, or not YAML of text keys that are there once, with values that can be read.
    """
    if not path.is_file():
        raise InputError(f"{path}: expected a file, found {'something else' if path.exists() else 'none'}")
    try:
        text = path.read_text(encoding="utf-8")
        _require_bounded(text)
        return _PlainKeyLoader(text).get_single_data()
    # ValueError, TypeError: a date of month 13, a number of more digits than Python reads, text that is not UTF-8.
    except (OSError, ValueError, TypeError, RecursionError, yaml.YAMLError) as error:
        raise InputError(f"{path}: expected valid YAML, found: {' '.join(str(error).split())}") from error


def _require_bounded(text: str) -> None:
    """Count levels, and values with those that aliases stand for, before anything is built."""
    sizes: dict[str, int] = {}
    open_: list[tuple[str | None, int]] = [(None, 0)]  # Anchor and values so far of each collection that is open.
    for event in yaml.parse(text, Loader=_PlainKeyLoader):
        line = event.start_mark.line + 1
        anchor, size = getattr(event, "anchor", None), 1
        if isinstance(event, yaml.CollectionStartEvent):
            open_.append((anchor, 1))
            if len(open_) > MOST_LEVELS + 1:
                raise ValueError(f"more than {MOST_LEVELS} levels of nesting, in line {line}")
            continue
        if isinstance(event, yaml.CollectionEndEvent):
            anchor, size = open_.pop()
        elif isinstance(event, yaml.AliasEvent):
            if anchor not in sizes:
                raise ValueError(f"the alias *{anchor} of nothing that ends before it, in line {line}")
            anchor, size = None, sizes[anchor]
        elif not isinstance(event, yaml.ScalarEvent):
            continue
        if anchor is not None:
            sizes[anchor] = size
        open_[-1] = (open_[-1][0], open_[-1][1] + size)
        if open_[-1][1] > MOST_VALUES:
            raise ValueError(f"more than {MOST_VALUES} values, with those that aliases stand for, in line {line}")
