"""Structured text that runs: the subset that the export writes, statement by statement turned into Python.

Variables of a block keep their values between calls, as on a PLC.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np

_UNIT = re.compile(r"^(FUNCTION_BLOCK|FUNCTION|PROGRAM) (\w+)[^\n]*\n(.*?)^END_\1$", re.MULTILINE | re.DOTALL)
_VAR = re.compile(r"^(VAR\w*)(?: CONSTANT)?\n(.*?)^END_VAR$", re.MULTILINE | re.DOTALL)
_DECLARED = re.compile(r"(\w+) : ([^:;]+?)(?: := ([^;]+))?;")
_WORDS = {"AND": "and", "OR": "or", "NOT": "not", "MOD": "%", "TRUE": "True", "FALSE": "False", "<>": "!=", "=": "=="}
_STANDARD = {
    "ABS": abs, "SQRT": math.sqrt, "SIN": math.sin, "COS": math.cos, "ASIN": math.asin, "ACOS": math.acos,
    "ATAN": math.atan, "MAX": max,
}  # fmt: skip


class Block:
    """An instance of a function block or program: its variables are attributes, a call runs its body once."""

    def __init__(self, known: dict[str, Any], variables: dict[str, Any], body: Any) -> None:
        self.__dict__ |= known | variables | {"_body": body}

    def __call__(self) -> None:
        exec(self._body, self.__dict__)


def load(text: str) -> dict[str, Callable[..., Any]]:
    """Functions, and makers of blocks and programs, by name."""
    text = re.sub(r"\(\*.*?\*\)", "", text, flags=re.DOTALL)
    known: dict[str, Any] = dict(_STANDARD)
    for sort, name, content in _UNIT.findall(text):
        sections = _VAR.findall(content)
        declared = [d for _, section in sections for d in _DECLARED.findall(section)]
        names = [d[0].lower() for d in declared]
        assert len(set(names)) == len(names), f"{name}: names differ by more than case"
        body = _python(_VAR.sub("", content))
        if sort == "FUNCTION":
            given = [s for head, s in sections if head in ("VAR_INPUT", "VAR_IN_OUT")]
            arguments = [d[0] for s in given for d in _DECLARED.findall(s)]
            local = [f"{n} = {_value(kind, init, known)!r}" for h, s in sections if h == "VAR"
                     for n, kind, init in _DECLARED.findall(s)]  # fmt: skip
            lines = [f"def {name}({', '.join(arguments)}):", *("    " + line for line in (*local, *body))]
            exec("\n".join([*lines, f"    return {name}_"]).replace(f"    {name} =", f"    {name}_ ="), known)
        else:
            compiled = compile("\n".join(body), name, "exec")

            def make(declared: list[Any] = declared, compiled: Any = compiled) -> Block:
                return Block(known, {n: _value(kind, init, known) for n, kind, init in declared}, compiled)

            known[name] = make
    return known


def _value(kind: str, init: str, known: dict[str, Any]) -> Any:
    array = re.fullmatch(r"ARRAY\[(.+)\] OF (\w+)", kind)
    if array:
        shape = [int(part.split("..")[1]) + 1 for part in array[1].split(",")]
        dtype = int if array[2] == "DINT" else float
        values = [float(v) for v in init.strip("[] \n").split(",")] if init else np.zeros(math.prod(shape))
        assert len(values) == math.prod(shape)
        return np.array(values).astype(dtype).reshape(shape)
    if kind in ("BOOL", "DINT", "LREAL"):
        return {"BOOL": bool, "DINT": int, "LREAL": float}[kind](init or 0)
    return known[kind]()


def _expression(text: str) -> str:
    return re.sub(r"<>|<=|>=|=|\b[A-Z]+\b", lambda m: _WORDS.get(m[0], m[0]), text)


def _python(text: str) -> list[str]:
    out, depth = [], 0
    for line in filter(None, map(str.strip, text.splitlines())):
        if re.fullmatch(r"END_(IF|FOR|WHILE)", line):
            depth -= 1
            continue
        loop = re.fullmatch(r"FOR (\w+) := (.+) TO (.+) DO", line)
        if loop:
            new, opens = f"for {loop[1]} in range({_expression(loop[2])}, {_expression(loop[3])} + 1):", True
        elif head := re.fullmatch(r"(IF|ELSIF|WHILE) (.+) (?:THEN|DO)", line):
            depth -= head[1] == "ELSIF"
            new, opens = f"{ {'ELSIF': 'elif'}.get(head[1], head[1].lower()) } {_expression(head[2])}:", True
        elif line == "ELSE":
            depth -= 1
            new, opens = "else:", True
        elif assigned := re.fullmatch(r"([\w.\[\], *+-]+) := (.+);", line):
            new, opens = f"{assigned[1]} = {_expression(assigned[2])}", False
        else:
            call = re.fullmatch(r"(\w+\(.*\));", line)
            assert call, f"no statement of the subset: {line}"
            new, opens = _expression(call[1]), False
        out.append("    " * depth + new)
        depth += opens
    assert depth == 0
    return out
