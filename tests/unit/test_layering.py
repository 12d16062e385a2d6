"""Imports point down only."""

from __future__ import annotations

import ast
import re

import pytest

from pipeline.base.code_digest import direct_imports, imported_modules

LAYERS = [
    {"base"},
    {"config", "geometry"},
    {"eyes", "metrics", "rendering", "synthesis"},
    {"budget", "capture"},
    {"calibration", "datasets", "detection", "lighting", "workflow"},
    {"sync", "tracking"},
    {"effects"},
    {"avatar"},
    {"figures"},
    {"export", "report", "viewer"},
    {"dials"},
    {"stages"},
]
"""Packages from the bottom up: a module imports its own package and packages of lower layers."""

FORBIDDEN = {"snakemake", "pickle", "dill", "joblib", "cloudpickle", "shelve", "marshal"}


@pytest.fixture(scope="module")
def modules(repo_root):
    """Dotted name -> file of every module of the project."""
    paths = sorted((repo_root / "pipeline").rglob("*.py"))
    names = [".".join(path.relative_to(repo_root).with_suffix("").parts).removesuffix(".__init__") for path in paths]
    return dict(zip(names, paths, strict=True))


def package_of(module):
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else ""


def test_every_package_has_a_layer(modules):
    packages = {package_of(name) for name, path in modules.items() if path.parent.name != "pipeline"}
    assert packages == set().union(*LAYERS)


def test_imports_point_down(modules):
    height = {package: level for level, packages in enumerate(LAYERS) for package in packages}
    upward = []
    for name, path in modules.items():
        for target in direct_imports(name, path) & modules.keys():
            own, other = package_of(name), package_of(target)
            if own and other and own != other and height[other] >= height[own]:
                upward.append(f"{name} imports {target}")
    assert not upward


def folder_of(module, modules):
    """The package that a module lies in; root modules of a package count as the package itself."""
    return module if modules[module].name == "__init__.py" else module.rpartition(".")[0]


def circles(graph):
    """Groups of nodes that reach each other, by Tarjan's algorithm."""
    order, low, waiting, found = {}, {}, [], []

    def visit(node):
        order[node] = low[node] = len(order)
        waiting.append(node)
        for target in sorted(graph[node]):
            if target not in order:
                visit(target)
            if target in waiting:
                low[node] = min(low[node], low[target])
        if low[node] == order[node]:
            group = waiting[waiting.index(node) :]
            del waiting[waiting.index(node) :]
            if len(group) > 1:
                found.append(sorted(group))

    for node in sorted(graph):
        if node not in order:
            visit(node)
    return found


def test_no_packages_of_any_depth_import_each_other_in_a_circle(modules):
    graph = {folder_of(name, modules): set() for name in modules}
    for name, path in modules.items():
        own = folder_of(name, modules)
        for target in direct_imports(name, path) & modules.keys():
            # `from a import b` names a and a.b: of a module the package is no import of its own.
            if modules[target].name != "__init__.py":
                graph[own] |= {folder_of(target, modules)} - {own}
    assert circles(graph) == []


def test_circles_are_found():
    graph = {"a": {"b"}, "b": {"c"}, "c": {"b", "d"}, "d": {"e"}, "e": set(), "f": {"a", "g"}, "g": {"f"}}
    assert circles(graph) == [["b", "c"], ["f", "g"]]


def test_stages_never_import_stages(modules):
    stages = {name for name, path in modules.items() if path.parent.name == "stages" and path.stem != "__init__"}
    crossing = {
        f"{name} imports {target}" for name in stages for target in direct_imports(name, modules[name]) & stages
    }
    assert not crossing


def test_no_stage_depends_on_the_workflow(modules):
    """Which jobs there are decides nothing about what a stage does: its code digest leaves that out."""
    stages = [name for name, path in modules.items() if path.parent.name == "stages"]
    bound = {name for name in stages for used in imported_modules(name) if used.startswith("pipeline.workflow")}
    assert len(stages) > 20 and not bound


def test_no_module_imports_what_is_forbidden(modules):
    found = {
        f"{name} imports {target}"
        for name, path in modules.items()
        for target in direct_imports(name, path)
        if target.split(".")[0] in FORBIDDEN
    }
    assert not found


def test_gsplat_is_imported_in_one_module(modules):
    users = [n for n, path in modules.items() if any(t.split(".")[0] == "gsplat" for t in direct_imports(n, path))]
    assert users == ["pipeline.rendering.splat_gsplat"]


def test_no_test_module_imports_another(repo_root):
    """What two of them need stands in tests/support."""
    found = []
    for path in sorted((repo_root / "tests").rglob("*.py")):
        targets = re.findall(r"^\s*(?:from|import) (tests[\w.]*)", path.read_text(), re.MULTILINE)
        found += [f"{path} imports {target}" for target in targets if not target.startswith("tests.support")]
    assert not found


def test_fakes_of_public_sets_know_nothing_of_what_reads_them(repo_root):
    """They are written from the sets' own programs; what both took from one place would agree and still be wrong."""
    layouts = sorted((repo_root / "tests/support/datasets").glob("*_layout.py"))
    assert len(layouts) >= 9
    for path in (*layouts, repo_root / "tests/support/datasets/turning_head.py"):
        found = re.findall(r"^\s*(?:from|import) (\w+[\w.]*)", path.read_text(), re.MULTILINE)
        assert not [name for name in found if name.startswith("pipeline")], path
        assert all(name.endswith(("_layout", "turning_head")) for name in found if name.startswith("tests")), path
    readers = [path.read_text() for path in (repo_root / "pipeline").rglob("*.py")]
    assert not [text for text in readers if re.search(r"^\s*(?:from|import) tests", text, re.MULTILINE)]


def test_no_call_unpickles(modules):
    """torch.load without weights_only=True and np.load with allow_pickle both unpickle."""
    found = []
    loading = [(name, text) for name, path in modules.items() if re.search("load|pickle", text := path.read_text())]
    for name, text in loading:
        for node in ast.walk(ast.parse(text)):
            if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
                continue
            called = ast.unparse(node.func)
            words = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
            if called == "torch.load" and words.get("weights_only") != "True":
                found.append(f"{name}: {ast.unparse(node)}")
            if words.get("allow_pickle", "False") != "False" or called in ("yaml.load", "yaml.unsafe_load"):
                found.append(f"{name}: {ast.unparse(node)}")
            if called in ("pd.read_pickle", "pandas.read_pickle"):
                found.append(f"{name}: {ast.unparse(node)}")
    assert not found
