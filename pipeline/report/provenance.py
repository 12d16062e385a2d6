"""Origin of a result: inputs, code, settings, packages and machine, and no one's paths."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
from html import escape
from pathlib import Path
from typing import Any

from pipeline.base.code_digest import code_digest
from pipeline.base.files import digest_bytes, digest_file
from pipeline.config.project import SECTIONS
from pipeline.report.part import Part
from pipeline.report.results import Results
from pipeline.report.tables import folded, html_table, paragraph

DISTRIBUTION = "lightstage-avatars"
BYTES_IN_GIB = 2**30


def provenance(results: Results) -> Part:
    """Everything needed to tell whether two reports are of the same thing."""
    parts = [
        *_imported(results),
        "<h3>Inputs</h3>", paragraph("BLAKE2b-128 of the indexed capture."),
        html_table("inputs", ["what", "digest"], input_digests(results), "ts"),
        "<h3>Code</h3>", _code(),
        "<h3>Settings</h3>", _settings(results),
        "<h3>Packages</h3>", folded("Versions", html_table("packages", ["package", "version"], versions(), "ss")),
        "<h3>Machine</h3>", paragraph("That of this page; stages may have run on others."),
        html_table("machine", ["what", "is"], machine(), "st"),
    ]  # fmt: skip
    return Part("Provenance", "".join(parts))


def _imported(results: Results) -> list[str]:
    """Table of what came from a public set and what did not, of captures from one."""
    notes = results.capture.get("imported")
    if not notes:
        return []
    titles = {"given": "taken from", "computed": "computed by", "left_out": "not used", "assumed": "assumed"}
    rows = [[what, titles[kind], how] for kind in titles for what, how in (notes.get(kind) or {}).items()]
    head = ["what", "is", "where and how"]
    return [f"<h3>Imported from {escape(notes['dataset'])}</h3>", html_table("imported", head, rows, "sst")]


def input_digests(results: Results) -> list[list[Any]]:
    """Rows (what, digest): every table of the index, the template, and all images together."""
    rows = [[path.name, digest_file(path)] for path in sorted((results.folder / "index").glob("*.*")) if path.is_file()]
    template = results.capture.get("template", {})
    rows += [[key.replace("_", " "), value] for key, value in template.items() if key.endswith("_digest")]
    images = results.table("index/images.parquet")
    columns = [name for name in ("digest", "mask_digest") if name in images]
    together = digest_bytes("\n".join(images[columns].astype(str).fillna("none").agg(" ".join, axis=1)).encode())
    return [*rows, [f"{len(images)} images and masks", together]]


def _code() -> str:
    rows = [[stage, code_digest(f"pipeline.stages.{stage}")] for stage in SECTIONS]
    whole = digest_bytes("\n".join(digest for _, digest in rows).encode())
    text = f"All stages: {whole}. A stage's digest is of its module and of all that it imports, without comments."
    return paragraph(text) + folded("Stage by stage", html_table("code", ["stage", "digest"], rows, "ss"))


def _settings(results: Results) -> str:
    rows = []
    for section, value in results.changed_settings.items():
        entries = value.items() if section in SECTIONS and isinstance(value, dict) else [("", value)]
        rows += [[section, key, without_paths(entry), _default(section, key)] for key, entry in entries]
    if not rows:
        return paragraph("All are the defaults.")
    text = paragraph("What differs from the defaults of config/config.yaml:")
    return text + html_table("settings", ["section", "setting", "value", "default"], rows, "sstt")


def _default(section: str, key: str) -> str:
    default = SECTIONS[section]().model_dump(mode="json").get(key) if section in SECTIONS else None
    return "–" if default is None else without_paths(default)


def without_paths(value: Any) -> str:
    """Setting's value without folders: of an absolute path only the file's name.

    The folders say only whose machine it was.
    """
    return re.sub(r"(?<![\w.])[/~][\w.+@ -]*(?:/[\w.+@ -]+)*", lambda found: f"…/{Path(found[0]).name}", str(value))


def versions() -> list[list[str]]:
    """Rows (package, version): Python, this project, and what it asks for."""
    rows = [["python", platform.python_version()]]
    try:
        asked = importlib.metadata.requires(DISTRIBUTION) or []
        rows.append([DISTRIBUTION, importlib.metadata.version(DISTRIBUTION)])
    except importlib.metadata.PackageNotFoundError:
        return [*rows, [DISTRIBUTION, "not installed as a package, so what it asks for is not known"]]
    for requirement in asked:
        if "extra ==" in requirement:
            continue
        name = re.match(r"[A-Za-z0-9._-]+", requirement)[0]
        try:
            rows.append([name, importlib.metadata.version(name)])
        except importlib.metadata.PackageNotFoundError:
            rows.append([name, "not installed"])
    return rows


def machine() -> list[list[str]]:
    """Rows (what, is): processor, cores, memory and system; never the machine's name."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / BYTES_IN_GIB
    return [
        ["processor", _processor()],
        ["cores", f"{len(os.sched_getaffinity(0))} of {os.cpu_count()} usable"],
        ["memory", f"{memory:.1f} GiB"],
        ["system", f"{platform.system()} {platform.release()}, {platform.machine()}"],
    ]


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith(("model name", "Model")))
    return next(named, "") or platform.processor() or platform.machine()
