"""The command line that every stage shares."""

from __future__ import annotations

import functools
import logging
import os
import signal
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

import tyro

from pipeline.base.address_space import require_address_space
from pipeline.base.errors import InputError
from pipeline.base.finished_jobs import USED, processor_seconds
from pipeline.base.output_lock import output_locked
from pipeline.base.start_up import resume_collection
from pipeline.base.stopping import Stopped, interrupted_once
from pipeline.base.watchdog import watched


def run_as_command(
    run: Callable[..., None], renamed: Mapping[str, str] = MappingProxyType({}), program: str | None = None
) -> None:
    """Turn a stage's `run` into its command line.

    Flags, help and defaults come from its signature and docstring. Prints an `InputError` as it stands and exits with
    1, likewise what the system refuses (`OSError`, `MemoryError`), and `Stopped` or Ctrl-C with 128 + the signal;
    anything else is a defect and keeps its traceback. A stage that stands still says where, after ten minutes
    (`pipeline.base.watchdog`). Its output is locked against a second one (`pipeline.base.output_lock`). When done, it
    says how long it has used a processor.

    Args:
        run: the stage.
        renamed: flags that were renamed, old -> new, as in `--promise` -> `--estimate`: both are understood.
        program: its name in the help; by default that of the file that Python was started with.
    """
    resume_collection()
    words = []
    for word in sys.argv[1:]:
        flag, sign, value = word.partition("=")
        words.append(renamed.get(flag, flag) + sign + value)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(name)s: %(message)s", datefmt="%H:%M:%S")
    try:
        require_address_space()
        with interrupted_once(), watched(sys.__stderr__):
            tyro.cli(_locked(run), prog=program, args=words, config=(tyro.conf.OmitArgPrefixes,))
        logging.getLogger(Path(sys.argv[0]).stem).info(USED.format(processor_seconds()))
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(1)
    except OSError as error:  # A full disk, a folder that cannot be written, a loop of links.
        print(f"error: {error}", file=sys.stderr)
        sys.exit(1)
    except MemoryError as error:
        print(f"error: out of memory: {error}; start fewer processes, or give the stage more", file=sys.stderr)
        sys.exit(1)
    except RuntimeError as error:  # Python's word for a thread that the system has no memory for.
        if "can't start new thread" not in str(error):
            raise
        print(f"error: out of memory: {error}; start fewer processes, or give the stage more", file=sys.stderr)
        sys.exit(1)
    except Stopped as stopped:
        print(stopped, file=sys.stderr)
        sys.exit(128 + stopped.number)
    except KeyboardInterrupt:
        print("stopped by SIGINT, as Ctrl-C sends it; the same command starts anew", file=sys.stderr)
        sys.exit(128 + signal.SIGINT)


def _locked(run: Callable[..., None]) -> Callable[..., None]:
    """A stage that holds the lock of its output while it runs."""

    @functools.wraps(run)
    def locked(**arguments: object) -> None:
        # Of processes that torchrun or srun starts, the first alone writes.
        if "out" not in arguments or int(os.environ.get("RANK", os.environ.get("SLURM_PROCID", 0))):
            run(**arguments)
            return
        chunk = [] if arguments.get("chunk") is None else [f"{arguments['chunk']:04d}"]
        with output_locked(arguments["out"], ".".join([Path(sys.argv[0]).stem, *chunk])):
            run(**arguments)

    return locked
