"""A process that has imported Snakemake, and forks a child for every call of it.

A plan takes half a second of a processor, the start of Python and Snakemake twice as much; tests plan about a hundred
times. A child has its own folder, modules and output, and nothing of `pipeline` is imported before it.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable
from pathlib import Path

LATE = ("pandas", "smart_open", "yte")
"""Modules that Snakemake imports when a call needs them: every run does."""


class SnakemakeServer:
    """The other end of the process; a context manager."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def __enter__(self) -> SnakemakeServer:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()

    def run(self, words: list[str], folder: Path, python: Path | None = None) -> subprocess.CompletedProcess[str]:
        """The finished `PYTHON -m snakemake WORDS` in a folder; its stdout has everything that was printed.

        Its jobs are started with that Python too, as the Snakefile says.
        """
        with tempfile.NamedTemporaryFile("r") as printed:
            self._call(words, folder, printed.name, python, False)
            return subprocess.CompletedProcess(words, self.wait(), stdout=printed.read())

    def start(self, words: list[str], folder: Path, printed: Path) -> int:
        """Start the same with a process group of its own, whose number this is; what it prints goes to a file.

        It has to be waited for before the next is started.
        """
        printed.touch()
        return self._call(words, folder, str(printed), None, True)

    def _call(self, words: list[str], folder: Path, printed: str, python: Path | None, own_group: bool) -> int:
        self._process.stdin.write(
            json.dumps([words, str(folder), str(python or sys.executable), printed, own_group]) + "\n"
        )
        self._process.stdin.flush()
        return int(self._process.stdout.readline())

    def wait(self) -> int:
        """Exit code of what was started; minus the signal's number if one ended it."""
        return int(self._process.stdout.readline())


def serve() -> None:
    """Answer each line of stdin, a call, by the number of its child and then by its exit code."""
    import snakemake.cli

    for late in LATE:
        importlib.import_module(late)
    snakemake.cli.get_argument_parser()  # It imports the plugins.
    gc.freeze()  # A child that collected what it shares with this process would copy it all.
    for line in sys.stdin:
        words, folder, python, printed, own_group = json.loads(line)
        child = os.fork()
        if not child:
            sys.executable = python
            if own_group:
                os.setpgid(0, 0)
                signal.signal(signal.SIGINT, signal.default_int_handler)  # Ignored in a script's background.
            _enter(folder, printed)
            os._exit(_exit_code(snakemake.cli.main, words))
        print(child, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)


def _enter(folder: str, printed: str) -> None:
    """Make this process one that was started in a folder as `python -m snakemake`, but for what is imported."""
    os.chdir(folder)
    sys.path[0] = folder
    nothing, output = os.open(os.devnull, os.O_RDONLY), os.open(printed, os.O_WRONLY)
    for number, target in enumerate((nothing, output, output)):
        os.dup2(target, number)


def _exit_code(main: Callable[[list[str]], None], words: list[str]) -> int:
    """What a call exits with; the half second in which Python tidies up what is imported is left out."""
    code = 1
    try:
        main(words)
    except SystemExit as stopped:
        code = int(stopped.code or 0)
    except BaseException:
        traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    return code


if __name__ == "__main__":
    serve()
