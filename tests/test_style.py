"""What no file may do, as far as a syntax tree shows it."""

import ast
import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TEXTS = {"problem", "remedy", "note", "message"}
"""Attributes that hold sentences for people."""
TESTS = {"startswith", "endswith", "find", "index", "match", "search", "fullmatch"}
"""Calls that look into a text."""


@cache
def nodes() -> tuple[tuple[str, ast.Call | ast.Compare], ...]:
    """Every call and comparison of the project's code, with its place."""
    found = []
    for file in sorted((ROOT / "pcalib").rglob("*.py")) + sorted((ROOT / "bench").rglob("*.py")):
        name = file.relative_to(ROOT).as_posix()
        tree = ast.parse(file.read_text(encoding="utf-8"))
        found += [(f"{name}:{n.lineno}", n) for n in ast.walk(tree) if isinstance(n, ast.Call | ast.Compare)]
    return tuple(found)


def is_name(node: ast.AST, name: str) -> bool:
    return isinstance(node, ast.Name) and node.id == name


def is_text(node: ast.AST) -> bool:
    """A sentence for people: error.problem, finding.note, str(error)."""
    if isinstance(node, ast.Call) and is_name(node.func, "str"):
        return bool(node.args) and ast.unparse(node.args[0]) in ("error", "e", "exception")
    return isinstance(node, ast.Attribute) and node.attr in TEXTS


def test_no_decision_hangs_on_the_wording_of_a_message():
    found = []
    for place, node in nodes():
        if isinstance(node, ast.Compare):
            literal = any(isinstance(n, ast.Constant) and n.value for n in (node.left, *node.comparators))
            bad = literal and any(map(is_text, (node.left, *node.comparators)))
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in TESTS:
            bad = any(map(is_text, (node.func.value, *node.args)))
        else:
            continue
        if bad:
            found.append(f"{place}: {ast.unparse(node)}")
    assert not found


def test_what_a_base_class_declares_is_not_asked_for_by_getattr():
    """Files of the user's own (effects/user.py) are looked into before they are known to be effects."""
    found = [
        f"{place}: {ast.unparse(node)}"
        for place, node in nodes()
        if isinstance(node, ast.Call) and is_name(node.func, "getattr") and isinstance(node.args[1], ast.Constant)
        and not place.startswith("pcalib/effects/user.py") and "import_module" not in ast.unparse(node)
        and ast.unparse(node.args[0]) != "_LOCAL"
    ]  # fmt: skip
    assert not found


def test_only_a_kind_reads_the_names_of_its_parameters():
    """Others ask the mechanism for rod lengths, motor zeros and parts; no pattern such as "l11" or "a1.x" elsewhere."""
    parameter = re.compile(r"^(?:[abplq]|beta|bp|leg|hinge|[\[(][a-z]+[\])])(?:\\+[dw]|\[|\(|\d*$)")
    found = []
    for place, node in nodes():
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in TESTS:
            said = [re.sub(r"\{.*?\}", "a", ast.unparse(a)).strip("rf'\"") for a in node.args]
            if any(parameter.match(text) for text in said) and "columns" not in place:
                found.append(f"{place}: {ast.unparse(node)}")
        strips = isinstance(node, ast.Call) and getattr(node.func, "attr", "") in ("strip", "rstrip")
        if strips and ast.unparse(node).endswith((".rstrip('0123456789')", ".strip('0123456789')")):
            found.append(f"{place}: {ast.unparse(node)}")
    assert not [f for f in found if not f.startswith("pcalib/kinds/")]
