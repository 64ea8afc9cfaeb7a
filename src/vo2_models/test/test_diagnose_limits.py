"""Every number that decides what a diagnosis answers stands in the record of limits."""

import ast
from dataclasses import fields
from pathlib import Path

import numpy as np
import vo2_models.diagnosis
from vo2_models.diagnosis.limits import Limits

NUMERICS = {
    "adequacy": "QUARTILE",
    "breakdown": "DEPTH MOVES ROUNDING",
    "courses": "SAME",
    "current_reading": "FEWEST FOLLOWS",
    "explain": "A_STEP FORESEEN LARGEST NEW NOTHING PRUNED ROUNDING SAME SHORTEST SMALLEST STUCK TOLD",
    "locate": "SETTLED SETTLED_BESIDE SLOW STAYS",
    "moved_alone": "_ENOUGH",
    "next_experiment": "A_STEP",
    "noise": "ABOUT AGREE ALONE CLOSE COMB FEWEST FEW_ABOUT MOSTLY_THERE RARE SELDOM",
    "nominal": "FAR NEAR REPEATS",
    "nuisance": "ENOUGH",
    "page": "SPANS WIDE",
    "pairs": "FAR SETTLES",
    "part": "AWAY BEYOND FEWEST FLAT TORN WHOLE",
    "problem": "STILL_K",
    "progress": "EVERY",
    "report": "OTHERS",
    "result": "ROUNDING SUMMED",
    "tangent": "FEW",
}
"""Module -> constants that it compares with: of numerics, of how samples are made ready, and of how much is tried or shown."""
PLAIN = {0, 1, 2}
"""Numbers that a comparison may hold as they are: counts, and what is neutral."""
TRIED = {"hypotheses"}
"""Modules whose numbers say where a search begins, not what is answered."""


def numbers(node):
    """Every number that is written down in a piece of syntax."""
    found = [each.value for each in ast.walk(node) if isinstance(each, ast.Constant)]
    return [value for value in found if isinstance(value, int | float) and not isinstance(value, bool)]


def constants(tree):
    """Names that a module binds to nothing but numbers."""
    for statement in tree.body:
        if isinstance(statement, ast.Assign) and numbers(statement.value):
            parts = {type(each) for each in ast.walk(statement.value)}
            if parts <= {ast.Constant, ast.Tuple, ast.UnaryOp, ast.USub, ast.Load}:
                names = (each for target in statement.targets for each in ast.walk(target))
                yield from (each.id for each in names if isinstance(each, ast.Name))


def test_every_number_of_a_decision_stands_in_the_record():
    trees = {
        p.stem: ast.parse(p.read_text("utf-8"))
        for p in Path(vo2_models.diagnosis.__file__).parent.glob("*.py")
    }
    known = {name: set(constants(tree)) for name, tree in trees.items()}
    literal, named = [], {}
    for name in trees.keys() - TRIED:
        here = set(known[name])
        for node in ast.walk(trees[name]):
            if isinstance(node, ast.ImportFrom) and node.module:
                here |= known.get(node.module.rpartition(".")[2], set()) & {each.name for each in node.names}
        for node in (each for each in ast.walk(trees[name]) if isinstance(each, ast.Compare)):
            if not PLAIN.issuperset(numbers(node)):
                literal.append(f"{name}.py:{node.lineno}: {ast.unparse(node)}")
            used = {each.id for each in ast.walk(node) if isinstance(each, ast.Name)} & here
            named[name] = named.get(name, set()) | used
    assert not literal, "give it a name, or a field of Limits where it decides an answer"
    assert {name: " ".join(sorted(used)) for name, used in named.items() if used} == NUMERICS


def test_every_limit_has_a_provenance_and_stands_in_the_record():
    said = Limits().with_provenance()
    assert set(said) == {each.name for each in fields(Limits)}
    assert all(np.isfinite(limit["value"]) and len(str(limit["provenance"])) > 20 for limit in said.values())
