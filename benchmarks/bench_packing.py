"""How often chart packing hangs under load: atlases destroyed in a loop against the pipeline's watched child.

`--place inline`: packings whose atlases are destroyed, until all are done or no processor time was used for 20 s.
`--place child`: unwrappings as the pipeline makes them, of 13 packings each. Prints one JSON line, with what was left
behind.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil
import trimesh

from pipeline.base.watched_child import processor_seconds
from pipeline.geometry.chart_packing import largest_packing
from pipeline.geometry.xatlas_child import PACKING_STEPS

STALL_S = 20.0

INLINE = """
import sys, numpy as np, xatlas, trimesh
mesh = trimesh.creation.box()
for number in range(int(sys.argv[1])):
    options = xatlas.PackOptions()
    options.resolution, options.padding, options.bruteForce = 64, 2, True
    atlas = xatlas.Atlas()
    atlas.add_mesh(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32))
    atlas.generate(xatlas.ChartOptions(), options)
    del atlas
    print(number + 1, flush=True)
"""


def loop_inline(packings: int) -> dict[str, object]:
    """Packings in one process that destroys each atlas; how many came to an end, and whether it stood still."""
    with tempfile.TemporaryDirectory() as folder:
        printed = Path(folder, "printed")
        with printed.open("w") as file:
            child = subprocess.Popen([sys.executable, "-c", INLINE, str(packings)], stdout=file)
        used, last_progress = 0.0, time.monotonic()
        while child.poll() is None and time.monotonic() - last_progress < STALL_S:
            time.sleep(1)
            now_used = processor_seconds(child.pid)
            if now_used > used:
                used, last_progress = now_used, time.monotonic()
        hung = child.poll() is None
        child.kill()
        child.wait()
        return {"packings": len(printed.read_text().split()), "hung": hung}


def loop_children(packings: int) -> dict[str, object]:
    """Unwrappings in children, one after the other, until there were so many packings."""
    box, done, slowest = trimesh.creation.box(), 0, 0.0
    while done < packings:
        start = time.monotonic()
        largest_packing(box.vertices, box.faces, 64, 2)
        slowest = max(slowest, time.monotonic() - start)
        done += PACKING_STEPS + 1
    return {"packings": done, "hung": False, "slowest_s": round(slowest, 2)}


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--place", choices=["inline", "child"], required=True)
    parser.add_argument("--packings", type=int, default=20_000)
    parser.add_argument("--load", type=int, default=4, help="processes that keep processors busy meanwhile")
    args = parser.parse_args()
    burners = [subprocess.Popen([sys.executable, "-c", "while True: sum(range(100000))"]) for _ in range(args.load)]
    try:
        start = time.monotonic()
        result = {"inline": loop_inline, "child": loop_children}[args.place](args.packings)
        seconds = time.monotonic() - start
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()
    own = psutil.Process()
    left = {"processes": len(own.children(recursive=True)), "threads": own.num_threads()}
    print(json.dumps({"place": args.place, "load": args.load, **result, "seconds": round(seconds, 1), "left": left}))


if __name__ == "__main__":
    main()
