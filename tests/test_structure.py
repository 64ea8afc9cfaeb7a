"""The structure of the code: which part knows which, read from the import statements."""

import ast
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

SOURCES = Path(__file__).resolve().parents[1] / "src"
NODES = {"vo2_plant_sim", "vo2_estimation", "vo2_control", "vo2_identification"}
ROS = {"rclpy", "rosbags", "launch", "builtin_interfaces", "sensor_msgs", "std_msgs", "std_srvs"}
ROS |= {"diagnostic_msgs", "trajectory_msgs", "ament_index_python"}
NEVER = {
    "vo2_models": ROS | NODES | {"vo2_interface", "vo2_studies"},
    "vo2_interface": NODES | {"vo2_studies"},
    **{node: {"vo2_studies"} for node in NODES},
    "rig_template": NODES | {"vo2_studies"},
}
"""Package -> what no module of it imports, at no place."""


@cache
def modules():
    """Name -> file of every module of the packages."""
    found = {}
    for package in SOURCES.iterdir():
        for path in (package / package.name).rglob("*.py"):
            name = ".".join(path.relative_to(package).with_suffix("").parts).removesuffix(".__init__")
            found[name] = path
    return found


@cache
def syntax(name):
    return ast.parse(modules()[name].read_text(encoding="utf-8"))


def imports(name, *, on_loading):
    """(module, name or none) of every import statement of a module; of those that run as it is loaded, if asked."""
    statements = list(syntax(name).body)
    while statements:
        node = statements.pop()
        if isinstance(node, ast.Import):
            yield from ((each.name, "") for each in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{name}: a relative import; this test and the readers want the whole name"
            yield from ((node.module or "", each.name) for each in node.names)
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and on_loading:
            continue
        elif isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            statements += node.orelse if on_loading else node.body + node.orelse
        else:
            statements += (part for part in ast.iter_child_nodes(node) if not isinstance(part, ast.expr))


def test_the_packages_are_read():
    packages = {name.partition(".")[0] for name in modules()}
    assert NODES | {"vo2_models", "vo2_interface", "vo2_studies", "rig_template"} == packages
    assert ("vo2_models.effects.record", "Effect") in set(imports("vo2_models.effects", on_loading=True))


@pytest.mark.parametrize("package", sorted(NEVER))
def test_borders(package):
    crossed = [
        f"{name} imports {source}"
        for name in modules()
        if name.partition(".")[0] == package
        for source, _ in imports(name, on_loading=False)
        if source.partition(".")[0] in NEVER[package]
    ]
    assert not crossed


def test_no_modules_load_each_other_in_a_circle():
    graph = {
        name: {
            target
            for source, part in imports(name, on_loading=True)
            for target in (source, f"{source}.{part}")
            if target in modules() and target != name
        }
        for name in modules()
    }
    # `from package import module` runs the package's own file first, which may be half loaded by then
    for name, targets in graph.items():
        graph[name] = {t for t in targets if not name.startswith(f"{t}.")}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def test_no_private_name_is_imported():
    taken = [
        f"{name} takes {part} from {source}"
        for name in modules()
        for source, part in imports(name, on_loading=False)
        if source.startswith("vo2_") and part.startswith("_") and not part.startswith("__")
    ]
    assert not taken
