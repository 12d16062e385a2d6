"""A process that has imported the libraries of the work, and forks a child for every stage of a workflow.

A stage of a tiny capture works for less than a second, and imports for one to three. A workflow that is run with
`PYTHON` in place of Python starts its jobs with it: `-m pipeline.stages.STAGE` goes to the server, with its folder,
environment and files, and ends as the stage ended; everything else goes to Python itself. Nothing of `pipeline` is
imported before the child.

Every stage has one thread: numba takes their number from the environment when it is imported, and hands it on to
OpenMP and so to torch, whose sums depend on it.
"""

from __future__ import annotations

import array
import contextlib
import gc
import importlib
import json
import os
import runpy
import signal
import socket
import subprocess
import sys
import tempfile
import traceback
from pathlib import Path

if __name__ != "__main__":  # The process itself traces nothing.
    import psutil

    from tests.support.network.system_calls import traced

LIBRARIES = (
    "cv2", "embreex", "numba", "pandas", "pyarrow.parquet", "pydantic", "scipy.optimize", "scipy.sparse.linalg",
    "scipy.spatial.transform", "torch", "trimesh", "tyro", "yaml",
)  # fmt: skip

PYTHON = """#!{python} -IS
import array, json, os, socket, sys
if sys.argv[1:2] != ["-m"] or not sys.argv[2].startswith("pipeline.stages."):
    os.execv("{python}", ["python", *sys.argv[1:]])
with socket.socket(socket.AF_UNIX) as server:
    server.connect("{address}")
    call = json.dumps([sys.argv[2:], os.getcwd(), dict(os.environ)]).encode()
    files = array.array("i", [0, 1, 2])
    server.sendmsg([len(call).to_bytes(8, "little")], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, files)])
    server.sendall(call)
    code = server.recv(1)
sys.exit(code[0] if code else 1)
"""


class StageServer:
    """The other end of the process; a context manager. Workflows are to be run with its `python`.

    With `trace`, a file, strace writes there what the process and all stages connect to and open.
    """

    def __init__(self, trace: Path | None = None) -> None:
        self._trace = trace

    def __enter__(self) -> StageServer:
        self._folder = tempfile.TemporaryDirectory()
        self.python, address = Path(self._folder.name) / "python", f"{self._folder.name}/stages"
        self.python.write_text(PYTHON.format(python=sys.executable, address=address))
        self.python.chmod(0o755)
        command = [sys.executable, __file__, address]
        self._process = subprocess.Popen(
            command if self._trace is None else traced(command, self._trace),
            stdout=subprocess.PIPE,
            env={**os.environ, "NUMBA_NUM_THREADS": "1"},
        )
        assert self._process.stdout.readline()
        return self

    @property
    def pid(self) -> int:
        """Process whose children are the stages."""
        return self._process.pid

    def __exit__(self, *_: object) -> None:
        # strace heeds no signal as long as what it traces runs; what it started ends, and so does it.
        own = psutil.Process(self._process.pid)
        for process in [own] if self._trace is None else own.children():
            process.terminate()
        self._process.wait()
        self._folder.cleanup()


def serve(address: str) -> None:
    """Fork a child for every call that comes in."""
    for library in LIBRARIES:
        importlib.import_module(library)
    gc.freeze()  # A child that collected what it shares with this process would copy it all.
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # Nobody waits for them: who has called is told by the child.
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(address)
        listening.listen()
        print("ready", flush=True)
        while True:
            caller, _ = listening.accept()
            if not os.fork():
                signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                listening.close()
                _answer(caller)
            caller.close()


def _answer(caller: socket.socket) -> None:
    """Run one stage as `python -m` does, say how it ended, and end."""
    size, ancillary, _, _ = caller.recvmsg(8, socket.CMSG_SPACE(3 * array.array("i").itemsize))
    files = array.array("i", ancillary[0][2])
    call = b""
    while len(call) < int.from_bytes(size, "little"):
        call += caller.recv(1 << 20)
    (module, *flags), folder, environment = json.loads(call)
    for number, file in enumerate(files):
        os.dup2(file, number)
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(folder)
    sys.path[0], sys.argv = folder, ["-m", *flags]
    stage = module.rpartition(".")[2]
    with contextlib.suppress(OSError):  # Traces name threads so; Linux keeps 15 letters.
        Path("/proc/self/comm").write_text(stage[:15])
    # Nothing is there: traces show which stage this process is from here on.
    with contextlib.suppress(OSError), open(f"/stage/{stage}"):
        pass
    code = 1
    try:
        runpy.run_module(module, run_name="__main__", alter_sys=True)
        code = 0
    except SystemExit as stopped:
        code = int(stopped.code or 0)
    except BaseException:
        traceback.print_exc()
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    with contextlib.suppress(BrokenPipeError):
        caller.send(bytes([code]))
    os._exit(0)


if __name__ == "__main__":
    serve(sys.argv[1])
