"""A public set, imported and taken through the stages that its calibration and meshes go into."""

from __future__ import annotations

from pathlib import Path

from pipeline.config.import_capture import ImportCapture
from pipeline.stages import calibrate_cameras, calibrate_color, calibrate_lights, import_capture, track_mesh
from pipeline.stages.index_capture import run as index_capture


def import_set(
    dataset: str, source: Path, folder: Path, settings: ImportCapture = ImportCapture()
) -> tuple[Path, Path]:
    """The folders of the native capture, and of the results of these stages."""
    capture, results = folder / "captures/someone", folder / "results"
    import_capture.run(dataset=dataset, source=source, subject="someone", out=capture, settings=settings)
    index_capture(capture=capture, out=results / "index")
    given = {"capture": capture, "index": results / "index", "out": results / "calibration"}
    calibrate_cameras.run(**given)
    calibrate_color.run(**given)
    calibrate_lights.run(**given, rig=results / "calibration/rig.json")
    cameras = results / "calibration/cameras.json"
    track_mesh.run(capture=capture, index=results / "index", cameras=cameras, chunk=0, out=results / "tracking")
    return capture, results
