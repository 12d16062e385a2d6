"""The documentation is in step with the code: generated pages, files, equations, papers and columns that it names."""

from __future__ import annotations

import posixpath
import re
import subprocess
import unicodedata

import cv2
import numpy as np
import pandas as pd
import pytest
import yaml

from docs.generate import (
    comparison_table,
    curves_figure,
    effects_table,
    error_budget_table,
    papers_dials,
    scaling_table,
)
from docs.generate.flowchart import FLOW, PLACES
from docs.generate.pages import PAGES
from docs.generate.pictures import evening
from docs.generate.references import entries
from docs.generate.results_table import run
from pipeline.base.files import write_json, write_table
from pipeline.base.verdicts import COLUMNS as VERDICT_COLUMNS
from pipeline.calibration.cameras.camera_calibration import QUALITY_COLUMNS
from pipeline.calibration.cameras.camera_calibration import RESIDUAL_COLUMNS as CORNER_RESIDUAL_COLUMNS
from pipeline.calibration.cameras.relative_poses import PAIR_COLUMNS
from pipeline.calibration.lights.light_tables import RESIDUAL_COLUMNS, TABLE_COLUMNS
from pipeline.config.effects import EFFECTS
from pipeline.config.project import SECTIONS
from pipeline.figures.calibration import RESIDUAL_COLUMNS as ALL_RESIDUAL_COLUMNS
from pipeline.lighting.environment import Environment
from pipeline.metrics.ablation_table import COLUMNS as COMPARISON_COLUMNS
from pipeline.metrics.cost import COLUMNS as COST_COLUMNS
from pipeline.stages.check_budget import COLUMNS as BUDGET_COLUMNS
from tests.support.results.curve_files import CURVES, write_subjects

FILE = re.compile(r"(?<![\w/.<>{}$*-])((?:[\w.-]+/)*[\w.-]+\.(?:md|py|smk|yaml|yml|toml|cff|bib|rst))\b(?![\w/<{*])")
"""A file of the repository's own kinds. Data files are left out: they are a user's, or a run's."""

MADE_OR_GIVEN = {
    "capture.yaml", "docs/capture_format.md", "capture_format.md", "contributing.md", "changelog.md",
    "config/subjects/someone.yaml", "config/subjects/mysubject.yaml", "tests/hard_cases/test_GROUP.py",
    "scene/gaussian_model.py", "becominglit/data/bl_dataset.py", "configs/default.yaml", "DATASHEET.md",
    "ca_code/utils/dataloader.py", "code/utils/metadata_readers.py", "intri.yml", "extri.yml",
    "scene/dataset_readers.py", "ltsg/utils/util_funcs.py", "actorshq/evaluation/evaluate.py",
    "ca_code/scripts/run_test.py", "config/rgca_example.yml", "code/run_json_writer_example.py", "constants.py",
    "becominglit/scripts/run_test.py",
    "config/presets/set_NAME.yaml", "data/nersemble_data.py", "util/color_correction.py",
    "color-calibration/exr2avif.py", "relighting/render_reference_envmap_relit.py", "calibration/README.md",
    "data/ava_dataset.py", "actorshq/dataset/camera_data.py", "actorshq/dataset/volumetric_dataset.py",
    "actorshq/evaluation/presets.py",
}  # fmt: skip
"""Names that are no file of the repository: a user's, an example's, another project's, or a page of the site."""

MADE_FOLDERS = ("captures/", "results/", "build/")
LEAVES = ("docs", "config", "pipeline", "tests", "benchmarks", "workflow", "envs")
TAG = re.compile(r"\b(RF?GCA) (\d+)(?:-(\d+))?")
CITATION = re.compile(r"\b([A-Z][\w-]+)(?: et al\.?| and [A-Z][\w-]+)?,? \(?((?:19|20)\d\d)\b")
VARIES = r"<[^>]*>|\.\.\.|: |expected |,? ?found "
"""What stands between the parts of a message that are always the same."""

NO_AUTHOR = {"MICCAI", "Transfer", "November", "Python", "SIGGRAPH", "CVPR", "Asia"}
PICTURE_BYTES = 300_000
README_LINES = 90


@pytest.fixture(scope="module")
def tracked(repo_root):
    """Path -> text of every text file of the repository."""
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"], cwd=repo_root, capture_output=True, text=True
    )
    names = [name for name in listed.stdout.splitlines() if (repo_root / name).is_file()]
    if not names:
        pytest.skip("no git repository")
    kept = {}
    for name in names:
        try:
            kept[name] = (repo_root / name).read_text()
        except UnicodeDecodeError:
            kept[name] = ""
    return kept


def code_of(tracked):
    return {name: text for name, text in tracked.items() if name.endswith((".py", ".smk", ".yaml"))}


@pytest.mark.parametrize("name", PAGES)
def test_generated_page_is_in_step_with_the_code(repo_root, name):
    assert (repo_root / name).read_text() == PAGES[name](), "run `make schema`"


def test_every_file_that_is_named_exists(tracked):
    """Of pages, comments and docstrings; a name without folder may lie in any folder."""
    base_names = {name.rpartition("/")[2] for name in tracked}
    missing = []
    for name, text in tracked.items():
        if ("/" in name and not name.startswith(LEAVES)) or name == "docs/references.bib":
            continue
        said = text if name.endswith(".md") else "\n".join(comments(text))
        for found in sorted(set(FILE.findall(said))):
            beside = posixpath.normpath(posixpath.join(posixpath.dirname(name), found))
            if (
                found in MADE_OR_GIVEN
                or found.startswith(MADE_FOLDERS)
                or {found, found.removeprefix("../"), beside} & tracked.keys()
            ):
                continue
            if found.rpartition("/")[2] in base_names and "/" not in found:
                continue
            missing.append(f"{name}: {found}")
    assert not missing


def comments(text):
    """Comments and quoted text of a file of code."""
    yield from re.findall(r"#.*", text)
    yield from re.findall(r'"""(.*?)"""', text, re.DOTALL)


def test_equations_that_the_code_cites_are_in_the_glossary(tracked):
    glossary = set(re.findall(r"^\| (RF?GCA \d+) \|", tracked["docs/glossary.md"], re.MULTILINE))
    cited = {}
    for name, text in code_of(tracked).items():
        for paper, first, last in TAG.findall(text):
            cited |= {f"{paper} {number}": name for number in range(int(first), int(last or first) + 1)}
    assert not {tag: name for tag, name in cited.items() if tag not in glossary}


def test_papers_that_the_code_cites_are_in_the_references(tracked):
    known = {(plain(name.split(",")[0]), fields["year"]) for fields in entries().values()
             for name in fields["author"].split(" and ")}  # fmt: skip
    cited = {}
    for name, text in code_of(tracked).items():
        if not name.startswith("tests/unit/test_docs"):
            said = "\n".join(comments(text))
            cited |= {(plain(author), year): name for author, year in CITATION.findall(said) if author not in NO_AUTHOR}
    assert not {found: name for found, name in cited.items() if found not in known}


def plain(name):
    """A name without accents and elisions, in the spelling that the code uses."""
    folded = unicodedata.normalize("NFKD", name.removeprefix("d'").replace("ö", "oe").replace("ü", "ue"))
    return "".join(letter for letter in folded if not unicodedata.combining(letter)).lower()


@pytest.mark.parametrize(
    ("table", "columns"),
    [
        ("metrics.csv", ["subject", "variant", "split", "lit", "images", "foreground_pixels", "region"]),
        ("comparison.csv", COMPARISON_COLUMNS),
        ("accuracy_cost.csv", COST_COLUMNS),
        ("budget.csv", BUDGET_COLUMNS),
        ("verdicts.csv", VERDICT_COLUMNS),
        ("calibration/quality_cameras.parquet", QUALITY_COLUMNS),
        ("calibration/pairs_cameras.parquet", PAIR_COLUMNS),
        ("calibration/residuals_cameras.parquet", CORNER_RESIDUAL_COLUMNS),
        ("calibration/residuals_lights.parquet", RESIDUAL_COLUMNS),
        ("calibration/residuals.parquet", ALL_RESIDUAL_COLUMNS),
        ("calibration/lights.parquet", [name for name in TABLE_COLUMNS if not name.startswith(("cov_", "color_"))]),
    ],
)
def test_every_column_of_a_table_is_explained(repo_root, table, columns):
    _, found, rest = (repo_root / "docs/results.md").read_text().partition(f"\n## `{table}`\n")
    assert found, f"no section about {table}"
    explained = set(re.findall(r"`(\w+)`", rest.partition("\n## ")[0]))
    assert not [column for column in columns if column not in explained]


def test_messages_under_troubleshooting_are_those_of_the_code(tracked):
    """Between what differs from case to case; strings that the code breaks over lines are joined."""
    sources = " ".join(text for name, text in code_of(tracked).items() if name.startswith(("pipeline", "workflow")))
    said = re.sub(r"\s+", " ", re.sub(r'"\s*\n\s*f?"', "", sources))
    page = tracked["docs/troubleshooting.md"].partition("\n## The workflow\n")[0]
    shown = re.findall(r"^\| `([^`]+)`", page, re.MULTILINE)
    parts = [part.strip(" ,:") for message in shown for part in re.split(VARIES, message)]
    assert len(shown) > 25
    assert not [part for part in parts if " " in part and part not in said]


def test_sun_of_the_pictures_sky_stands_low_on_the_right():
    """Where its brightest pixel looks, by the reader of panoramas."""
    sky = Environment(evening())
    sun = sky.directions().reshape(-1, 3)[sky.radiance.sum(2).argmax()]
    assert sun[0] > 0.6 and 0.2 < sun[1] < 0.4


def page_with_marks(path, name):
    path.write_text(f"<!-- {name}: begin -->\n<!-- {name}: end -->\n")
    return path


def test_comparison_has_a_row_for_each_avatar_and_none_for_their_mean(tmp_path):
    rows = [
        {"subject": subject, "variant": variant, "baseline": "full", "lit": lit, "metric": metric, "images": 7,
         "mean": mean, "mean_error": 0.25, "difference": mean - 31 if variant == "pbr" else None,
         "difference_error": 0.5}
        for subject in ("all", "ann") for variant, psnr in (("full", 31.0), ("pbr", 29.5)) for lit in ("all", "partial")
        for metric, mean in (("psnr_db", psnr - (lit == "partial")), ("ssim", 0.9), ("flip", 0.1))
    ]  # fmt: skip
    pd.DataFrame(rows).to_csv(tmp_path / "comparison.csv")
    page = page_with_marks(tmp_path / "page.md", "comparison")
    comparison_table.run(comparison=tmp_path / "comparison.csv", page=page)
    assert page.read_text().splitlines()[1:-1] == [
        "| subject | variant | images | PSNR, dB | partially lit | against `full` | SSIM | FLIP |",
        "|---|---|---|---|---|---|---|---|",
        "| `ann` | `full` | 7 | 31.00 ± 0.25 | 30.00 ± 0.25 |  | 0.900 | 0.100 |",
        "| `ann` | `pbr` | 7 | 29.50 ± 0.25 | 28.50 ± 0.25 | -1.50 ± 0.50 | 0.900 | 0.100 |",
    ]


def test_error_budgets_have_a_row_and_a_picture_per_subject(tmp_path):
    folders = []
    for name, lost in {"ann": 1.0, "bob": 0.25}.items():
        folders.append(tmp_path / "results" / name)
        budget = {
            "step": ["all true", "our color"],
            "test_all_db": [33.0, 33.0 - lost],
            "test_partial_db": [31.0, 30.5],
        }
        write_table(folders[-1] / "error_budget/error_budget.csv", pd.DataFrame(budget))
        (folders[-1] / "error_budget/error_budget.png").write_bytes(name.encode())
    (tmp_path / "docs/pictures").mkdir(parents=True)
    page = page_with_marks(tmp_path / "docs/page.md", "error budgets")
    error_budget_table.run(results=tuple(folders), page=page)
    assert page.read_text().splitlines()[1:-1] == [
        "| subject | all true | our color | lost |",
        "|---|---|---|---|",
        "| `ann` | 33.00 (31.00) | 32.00 (30.50) | 1.00 |",
        "| `bob` | 33.00 (31.00) | 32.75 (30.50) | 0.25 |",
        "",
        "![ann: what each input costs](pictures/error_budget_ann.png)",
        "",
        "![bob: what each input costs](pictures/error_budget_bob.png)",
    ]
    assert (tmp_path / "docs/pictures/error_budget_bob.png").read_bytes() == b"bob"


def test_effects_are_compared_by_scene_and_in_the_median(tmp_path):
    rows = [
        ("dull", "everything", "specular shadow", 30.0, 0.0, 1.0, "a"), ("dull", "full", None, 30.25, -0.25, 0.5, "a"),
        ("dull", "auto", None, 31.0, -1.0, 0.05, "a"), ("dull", "not_shadow", None, 30.9, -0.9, 0.1, "a"),
        ("dull", "not_specular", None, 31.2, -1.2, 0.1, "a"),
        ("shiny", "everything", "specular shadow", 28.0, 0.0, 1.0, "a"),
        ("shiny", "full", "specular near_field", 27.75, 0.25, 0.7, "a"),
        ("shiny", "auto", "specular near_field", 29.0, -1.0, 0.25, "a"),
        ("shiny", "half", "specular near_field", 28.5, -0.5, 0.125, "a"),
    ]  # fmt: skip
    columns = ["scene", "avatar", "effects", "psnr_db", "psnr_lost_db", "cpu_ratio", "draw"]
    pd.DataFrame(rows, columns=columns).to_csv(tmp_path / "table.csv")
    again = [row for row in rows if row[0] == "dull" and not row[1].startswith("not")]
    again = [(*row[:4], 2 * row[4], row[5], "b") for row in again]
    pd.DataFrame(again, columns=columns).to_csv(tmp_path / "again.csv")
    page = page_with_marks(tmp_path / "page.md", "effects comparison")
    page.write_text(page.read_text() + page_with_marks(tmp_path / "other.md", "effects turned round").read_text())
    effects_table.run(comparison=(tmp_path / "table.csv", tmp_path / "again.csv"), page=page)
    lines = page.read_text().splitlines()
    assert lines[3:6] == [
        # Of 0.25 and 0.5 dB, and of 1 and 2 dB, half the difference is the standard error.
        "| dull | none | 30.00 dB | +0.38 ± 0.12 dB | 50 % | +1.50 ± 0.50 dB | 5.0 % | - | - |",
        "| shiny | specular, near field | 28.00 dB | -0.25 dB | 70 % | +1.00 dB | 25 % | +0.50 dB | 12 % |",
        "| median |  |  | +0.06 dB | 60 % | +1.25 dB | 15 % | +0.50 dB | 12 % |",
    ]
    assert lines[8:-1] == [
        "| scene | shadow | specular |",
        "|---|---|---|",
        "| dull | off, turned -0.10 dB | off, turned +0.20 dB |",
        "| shiny | - | - |",
    ]


def test_scaling_has_a_row_per_cost_and_no_exponent_where_none_is_told(tmp_path):
    row = {"stage": "track_mesh", "varied": "frames", "cost": "CPU seconds", "smallest": 8, "largest": 4096.0,
           "predicted": 1.0, "exponent": 0.98, "low": 0.9, "high": 1.06, "verdict": "as predicted"}  # fmt: skip
    flat = row | {"cost": "peak MB", "predicted": 0.0, "exponent": np.nan, "verdict": "cannot tell"}
    write_table(tmp_path / "scaling/exponents.csv", pd.DataFrame([row, flat]))
    (tmp_path / "scaling/scaling.png").write_bytes(b"png")
    (tmp_path / "pictures").mkdir()
    page = page_with_marks(tmp_path / "page.md", "scaling")
    scaling_table.run(results=tmp_path / "scaling", page=page)
    assert page.read_text().splitlines()[3:-1] == [
        "| `track_mesh` | frames | CPU seconds | 8 | 4,096 | 1 | 0.98 (0.90 to 1.06) | as predicted |",
        "| `track_mesh` | frames | peak MB | 8 | 4,096 | 0 |  | cannot tell |",
    ]
    assert (tmp_path / "pictures/scaling.png").exists()


def test_papers_dials_have_their_reference_first_and_a_line_per_value(tmp_path):
    lost, picture = "PSNR lost on validation images, partial lit, dB (reference 16)", "time of a picture, ms"
    measured = {
        "imports only": (2.0, {lost: (np.nan, np.nan)}),
        "8": (20.0, {lost: (0.251, 0.0149), picture: (40.4, np.nan)}),
        "16": (25.0, {lost: (0.0, 0.0), picture: (50.0, np.nan)}),
    }
    rows = [
        {"dial": "code_size", "setting": setting, "metric": metric, "error": error, "standard_error": scatter,
         "cpu_seconds": seconds}
        for setting, (seconds, metrics) in measured.items() for metric, (error, scatter) in metrics.items()
    ]  # fmt: skip
    write_table(tmp_path / "one/accuracy_cost.csv", pd.DataFrame([*rows, rows[-1] | {"dial": "texel_size"}]))
    page = page_with_marks(tmp_path / "page.md", "papers' dials")
    papers_dials.run(costs=(tmp_path / "one/accuracy_cost.csv",), page=page)
    assert page.read_text().splitlines()[3:-1] == [
        "| `one` | `code_size` | `16` |  | 25 | 1.00 | 50 |",
        "| `one` | `code_size` | `8` | 0.25 ± 0.01 | 20 | 0.80 | 40 |",
    ]


def test_row_of_results_repeats_the_scores_of_all_held_out_images(tmp_path):
    scores = {"psnr_db": [20.0, 25.0, 30.0], "ssim": 0.9, "flip": 0.1, "images": 7, "lit": ["all", "full", "partial"]}
    pd.DataFrame(scores | {"subject": "one", "variant": "full", "split": "test"}).to_csv(tmp_path / "metrics.csv")
    for name, count in {"cameras": 3, "lights": 4, "frames": 5}.items():
        write_table(tmp_path / f"index/{name}.parquet", pd.DataFrame({"number": range(count)}))
    write_json(tmp_path / "index/capture.json", {"kind": "head"})
    (tmp_path / "benchmarks").mkdir()
    jobs = {"track_mesh.0000": 60, "train_avatar.full": 120, "train_avatar.other": 600, "write_report": 60}
    for job, seconds in jobs.items():
        (tmp_path / f"benchmarks/{job}.tsv").write_text(f"s\tcpu_time\n{seconds}\t1\n")
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- results: begin -->\n| a |\n|---|\n| `none` | kept |\n<!-- results: end -->\nafter\n")
    run(results=(tmp_path,), page=page)
    text = page.read_text()
    assert "| `one` | head: 3 cameras, 4 lights, 5 frames | 7 | 20.00 | 25.00 | 30.00 | 0.900 | 0.100 | 3 |" in text
    assert "| `none` | kept |" in text and text.endswith("after\n")


def test_every_effect_is_explained(repo_root):
    table = (repo_root / "docs/effects.md").read_text()
    assert not [effect for effect in EFFECTS if f"| `{effect}` |" not in table]


def test_every_stage_is_on_the_page_of_stages(repo_root):
    page = (repo_root / "docs/pipeline.md").read_text()
    assert not [stage for stage in SECTIONS if f"`{stage}`" not in page]


def test_flowchart_draws_known_stages_once_and_below_what_they_wait_for():
    assert FLOW.keys() == PLACES.keys() and FLOW.keys() <= SECTIONS.keys()
    assert len(set(PLACES.values())) == len(PLACES)
    assert all(PLACES[before][1] < PLACES[stage][1] for stage, waits in FLOW.items() for before in waits)


def test_every_page_is_in_the_navigation(repo_root):
    nav = yaml.safe_load(re.sub(r"!!python\S*", "", (repo_root / "mkdocs.yml").read_text()))["nav"]
    listed = {page for entry in nav for part in entry.values() for page in pages_of(part)}
    assert listed >= {path.name for path in (repo_root / "docs").glob("*.md")}


def pages_of(part):
    return (
        [part]
        if isinstance(part, str)
        else [page for entry in part for value in entry.values() for page in pages_of(value)]
    )


def test_readme_is_a_door(repo_root):
    text = (repo_root / "README.md").read_text()
    assert len(text.splitlines()) <= README_LINES
    assert text.count("<!-- results: begin -->") == text.count("<!-- results: end -->") == 1
    for needed in (
        "make results/subjectA/metrics.csv",
        "make test",
        "2501.14726",
        "2312.03704",
        "CITATION.cff",
        "LICENSE",
    ):
        assert needed in text
    shown = [repo_root / name for name in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", text)]
    assert shown and sum(path.stat().st_size for path in shown) < PICTURE_BYTES


def test_citation_file_has_what_its_format_requires(repo_root):
    content = yaml.safe_load((repo_root / "CITATION.cff").read_text())
    assert content["cff-version"] == "1.2.0"
    assert content.keys() >= {"message", "title", "authors", "version", "license", "references"}
    assert all({"type", "title", "authors"} <= one.keys() for one in content["references"])


def test_curves_are_drawn_in_a_panel_per_dial_and_a_line_per_subject(tmp_path):
    curves = write_subjects(tmp_path / "curves", {"ann": CURVES, "bob": CURVES})
    curves_figure.run(curves=curves, out=tmp_path / "curves.png")
    picture = cv2.imread(str(tmp_path / "curves.png")).astype(int)
    # Both subjects have the same curves, so that the second one's hide the first's but in the legend.
    first, second = (
        np.abs(picture[..., ::-1] - [int(color[at : at + 2], 16) for at in (1, 3, 5)]).max(-1) < 8
        for color in curves_figure.COLORS[:2]
    )
    height = len(picture)
    assert first[: height // 3].any() and not first[height // 3 :].any()
    rows = np.flatnonzero(second.any(1))
    assert rows.max() > 0.6 * height  # two rows of panels
