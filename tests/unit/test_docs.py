"""The documentation is in step with the code: generated pages, files, equations, papers and columns that it names."""

from __future__ import annotations

import posixpath
import re
import subprocess
import unicodedata

import pytest
import yaml

from docs.generate.flowchart import FLOW, PLACES
from docs.generate.pages import PAGES
from docs.generate.pictures import evening
from docs.generate.references import entries
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
