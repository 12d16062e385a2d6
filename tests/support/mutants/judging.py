"""Judging mutants one by one: planted in a copy, and seen by a test or not."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.support.mutants import trial
from tests.support.mutants.mutant import Mutant
from tests.support.mutants.records import Judgement, Verdict, append, read
from tests.support.mutants.tree import Tree

ALLOWED_TIMES, ALLOWED_S = 5.0, 30.0
"""Times that tests may take of what they take without a change, and seconds more, for a busy machine."""

COMPILING_S = 240.0
"""Seconds more for a mutant of compiled kernels: all that the tests call are compiled anew."""

UNSOUND_S = 600.0

PASSED, FAILED = 0, 1
"""Exit codes of pytest; others say that no test has run."""


class UnsoundError(Exception):
    """Tests that fail without any change: they can judge nothing."""


@dataclass
class Court:
    """What judges: a copy of the project, and the table that judgements are kept in."""

    tree: Tree
    out: Path
    patience_s: float = ALLOWED_S

    def __post_init__(self) -> None:
        self.table, self._scratch = self.out / "mutants.csv", self.out / "scratch"
        self._done = {judgement.digest: judgement for judgement in read(self.table)}

    def judged(self, mutants: Sequence[Mutant]) -> Iterator[Judgement]:
        """Judgements of mutants, kept or made.

        Raises:
            UnsoundError: if tests fail without a change.
        """
        for number, mutant in enumerate(mutants, 1):
            digest = mutant.digest(self.tree.copy)
            if digest not in self._done:
                self._keep(self._judge(mutant, number, digest))
            yield self._done[digest]

    def kept(self, mutants: Sequence[Mutant]) -> list[tuple[Mutant, Judgement]]:
        """Mutants that have been judged, with their judgements."""
        digests = [(mutant, mutant.digest(self.tree.copy)) for mutant in mutants]
        return [(mutant, self._done[digest]) for mutant, digest in digests if digest in self._done]

    def _judge(self, mutant: Mutant, number: int, digest: str) -> Judgement:
        seconds, compiled, verdict, by = 0.0, mutant.is_compiled(self.tree.copy), Verdict.SURVIVED, ""
        for tests in mutant.tests:
            allowed_s = ALLOWED_TIMES * self._sound(tests).seconds + self.patience_s + COMPILING_S * compiled
            with self.tree.planted(mutant, number):
                tried = trial.run_tests(self.tree.copy, [tests], self._scratch, allowed_s, compiled)
            seconds, by = seconds + tried.seconds, tried.failed
            verdict = {None: Verdict.STOPPED, PASSED: Verdict.SURVIVED, FAILED: Verdict.KILLED}.get(
                tried.code, Verdict.UNJUDGED
            )
            if verdict is Verdict.UNJUDGED:
                (self.out / "unjudged.log").write_text(f"{mutant}\n{tried.printed}")
            if verdict is not Verdict.SURVIVED:
                break
        return Judgement(mutant.layer, f"{mutant.file}: {mutant.meaning}", digest, verdict, seconds, by)

    def _sound(self, tests: str) -> Judgement:
        """The time of tests without a change."""
        path = self.tree.copy / tests.partition("::")[0]
        digest = hashlib.sha256(tests.encode())
        for file in sorted(path.rglob("test_*.py")) if path.is_dir() else [path]:
            digest.update(file.read_bytes())
        key = digest.hexdigest()[:16]
        if key not in self._done:
            tried = trial.run_tests(self.tree.copy, [tests], self._scratch, UNSOUND_S)
            if tried.code != PASSED:
                raise UnsoundError(f"{tests}: expected to pass without a change:\n{tried.printed[-3000:]}")
            self._keep(Judgement("", tests, key, Verdict.SOUND, tried.seconds, ""))
        return self._done[key]

    def _keep(self, judgement: Judgement) -> None:
        append(self.table, judgement)
        self._done[judgement.digest] = judgement
