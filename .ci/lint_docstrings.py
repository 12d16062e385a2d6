"""First sentences of docstrings: short, on one line, naming the thing or starting with a verb.

    python .ci/lint_docstrings.py [--summary] [FILE ...]

checks the modules, public classes, functions and methods of the files given, or of all of `pipeline`, prints
`path:line: message` for every defect and exits with 1 if there is one. Missing docstrings are ruff's to report.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

LONGEST = 90
"""Letters of a first sentence, with its full stop: one line of an index of modules or functions."""

QUESTION_WORDS = ("What", "Which", "Where", "Those", "How", "When", "Whether", "If", "Why", "Who")
"""Openings of a clause that describes a thing without naming it."""

SECTION = re.compile(r"(Args|Attributes|Example|Examples|Raises|Returns|Yields):$")

ABBREVIATIONS = (
    "e.g.",
    "i.e.",
    "etc.",
    "cf.",
    "vs.",
    "al.",
    "Eq.",
    "Eqs.",
    "Fig.",
    "Figs.",
    "Sec.",
    "App.",
    "Tab.",
    "...",
)
"""Full stops that end no sentence when text goes on behind them."""

SENTENCE_END = re.compile(r"[.?!][)\"'`]*(?=\s|$)")

Documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def documented(tree: ast.Module) -> Iterator[Documented]:
    """The module, its public classes and functions, and the public methods and classes inside those classes."""
    waiting: list[Documented] = [tree]
    for node in waiting:
        yield node
        if isinstance(node, ast.Module | ast.ClassDef):
            inside = (item for item in node.body if isinstance(item, Documented))
            waiting += [item for item in inside if not item.name.startswith("_")]


def first_sentence(text: str) -> str:
    """The text up to the first full stop that ends a sentence, or the whole first paragraph."""
    paragraph = re.split(r"\n\s*\n", text.strip(), maxsplit=1)[0]
    for end in SENTENCE_END.finditer(paragraph):
        sentence = paragraph[: end.end()]
        if end.end() == len(paragraph) or not sentence.endswith(ABBREVIATIONS):
            return sentence
    return paragraph


def complaints(text: str) -> list[str]:
    """Everything that is wrong with the first sentence of a docstring."""
    if SECTION.match(text.strip().split("\n", 1)[0].strip()):
        return ["starts with a section, has no first sentence"]
    sentence = first_sentence(text)
    first_word = re.match(r"\w*", sentence).group()
    flat = " ".join(sentence.split())
    found = []
    if len(flat) > LONGEST:
        found.append(f"first sentence has {len(flat)} letters, at most {LONGEST}")
    if "\n" in sentence or text.startswith("\n"):
        found.append("first sentence does not end on the first line")
    if first_word in QUESTION_WORDS:
        found.append(f"first sentence starts with {first_word!r}: name the thing, or start with a verb")
    if not re.search(r"[.?!:][)\"'`]*$", flat):
        found.append("first sentence does not end with a full stop")
    return found


def defects(source: str) -> list[tuple[int, str]]:
    """Line and message of every defect in a module's source, in the order of lines."""
    found = []
    for node in documented(ast.parse(source)):
        text = ast.get_docstring(node, clean=False)
        if text:
            name = getattr(node, "name", "module")
            found += [(node.body[0].lineno, f"{name}: {complaint}") for complaint in complaints(text)]
    return sorted(found)


def main() -> int:
    """Print every defect; the exit code is 1 if there is one."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="*", type=Path, help="default: every module of pipeline")
    parser.add_argument("--summary", action="store_true", help="print counts per package in place of every defect")
    arguments = parser.parse_args()
    counts: Counter[str] = Counter()
    for path in arguments.files or sorted((ROOT / "pipeline").rglob("*.py")):
        shown = path.resolve().relative_to(ROOT) if path.resolve().is_relative_to(ROOT) else path
        for line, message in defects(path.read_text()):
            counts["/".join(shown.parts[:2])] += 1
            if not arguments.summary:
                print(f"{shown}:{line}: {message}")
    if arguments.summary:
        for package, count in counts.most_common():
            print(f"{count:5d} {package}")
        print(f"{counts.total():5d} in all")
    return 1 if counts else 0


if __name__ == "__main__":
    sys.exit(main())
