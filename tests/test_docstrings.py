"""Docstrings of the libraries: every public function tells its parameters and what it returns, and examples are true."""

import doctest
import re
from importlib import import_module
from pathlib import Path

import griffe
import pytest

ROOT = Path(__file__).resolve().parents[1]
LIBRARIES = (
    "vo2_models",
    "vo2_interface",
    "vo2_plant_sim",
    "vo2_estimation",
    "vo2_control",
    "vo2_identification",
    "rig_template",
)


def functions():
    """Every function that a module of the libraries lists in `__all__`, but compiled ones, which take packed arrays."""
    for library in LIBRARIES:
        modules = [griffe.load(library, search_paths=[ROOT / "src" / library])]
        while modules:
            module = modules.pop()
            modules += [
                member for member in module.members.values() if not member.is_alias and member.is_module
            ]
            for name in map(str, module.exports or ()):
                member = module.members.get(name)
                if member is not None and not member.is_alias and member.is_function and not compiled(member):
                    yield member


def compiled(function):
    return any(
        str(decorator.value).startswith(("kernel", "inner", "inside")) for decorator in function.decorators
    )


FUNCTIONS = list(functions())


def test_the_libraries_are_read():
    assert {"fit_model", "self_sensing", "fit_preisach"} <= {function.name for function in FUNCTIONS}


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda function: function.path)
def test_parameters_and_result_are_told(function):
    text = function.docstring.value if function.docstring else ""
    assert text, "no docstring"
    words = set(re.findall(r"\w+", text))
    missing = [p.name for p in function.parameters if p.name not in words]
    assert not missing, f"parameters that are not told: {', '.join(missing)}"
    if str(function.returns) not in ("None", "Never"):
        assert re.search(r"[Rr]eturn|[Yy]ield", text), f"what it returns ({function.returns}) is not told"


# an example that is only shown is none
EXAMPLES = sorted(
    ".".join(path.relative_to(ROOT / "src" / library).with_suffix("").parts).removesuffix(".__init__")
    for library in (*LIBRARIES, "vo2_studies")
    for path in (ROOT / "src" / library / library).rglob("*.py")
    if re.search(r"^\s*>>> (?!.*\+SKIP)", path.read_text(encoding="utf-8"), re.MULTILINE)
)


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_give_what_they_say(name):
    result = doctest.testmod(import_module(name))
    assert result.attempted > 0 and result.failed == 0
