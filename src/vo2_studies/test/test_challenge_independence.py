"""The generator must not share code with what it tests: checked on the syntax trees of all its files."""

import ast
from pathlib import Path

import vo2_studies.challenge as challenge

FOLDER = Path(challenge.__file__).parent
# compiling, writing files and messages, drawing pages: no physics in them
ALLOWED = {
    "vo2_models.command_line",
    "vo2_models.recording",
    "vo2_models.validation",
    "vo2_identification.bags",
    "vo2_identification.bags.joint_state",
    "vo2_models.io",
    "vo2_models.numerics.kernel",
    "vo2_models.page.figures",
    "vo2_models.page.page",
}
OWN = "vo2_studies.challenge"


def imported(tree: ast.AST) -> set[str]:
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative imports hide where a name comes from"
            names.add(node.module or "")
        elif isinstance(node, ast.Call) and getattr(node.func, "id", getattr(node.func, "attr", "")) in (
            "import_module",
            "__import__",
            "exec",
            "eval",
        ):
            raise AssertionError("an import by name could reach anything")
    return names


def test_no_module_of_the_simulation_is_imported():
    files = sorted(FOLDER.rglob("*.py"))
    assert len(files) > 15
    for file in files:
        project = {
            name
            for name in imported(ast.parse(file.read_text("utf-8")))
            if name.split(".")[0].startswith("vo2_")
        }
        foreign = {
            name
            for name in project
            if name not in ALLOWED and not (name == OWN or name.startswith(OWN + "."))
        }
        assert not foreign, f"{file.name} imports {', '.join(sorted(foreign))}"


def test_the_check_sees_a_forbidden_import():
    assert imported(ast.parse("def f():\n    from vo2_models.effects import creep")) == {"vo2_models.effects"}
