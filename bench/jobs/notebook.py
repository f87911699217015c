"""Runs the cells of a notebook one after another, as Jupyter would, and keeps what they print and show.

    python -m bench.jobs.notebook docs/notebooks/story.ipynb     # from the project's folder; writes the outputs into it
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pcalib import files


def run(notebook: dict[str, Any], names: dict[str, Any]) -> Iterator[tuple[dict[str, Any], list[dict[str, Any]]]]:
    """Every code cell with its outputs, in nbformat 4.

    Args:
        names: the names that cells see and define.
    """
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            yield cell, _outputs("".join(cell["source"]), names)


def _outputs(code: str, names: dict[str, Any]) -> list[dict[str, Any]]:
    """What a cell prints, and the value of its last line where that is an expression."""
    tree = ast.parse(code)
    last = tree.body[-1] if tree.body else None
    last = last if isinstance(last, ast.Expr) else None
    tree.body = tree.body if last is None else tree.body[:-1]
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, "cell", "exec"), names)
        value = None if last is None else eval(compile(ast.Expression(last.value), "cell", "eval"), names)
    out: list[dict[str, Any]] = []
    if printed.getvalue():
        out.append({"output_type": "stream", "name": "stdout", "text": printed.getvalue().splitlines(keepends=True)})
    if value is not None:
        shown = {"text/plain": repr(value).splitlines(keepends=True)}
        if hasattr(value, "_repr_html_"):
            shown = {"text/html": value._repr_html_().splitlines(keepends=True)}
        out.append({"output_type": "execute_result", "execution_count": None, "metadata": {}, "data": shown})
    return out


def main(arguments: list[str] | None = None) -> None:
    """Run a notebook and write it with its outputs."""
    parser = argparse.ArgumentParser(description="Run a notebook's cells and keep their outputs.")
    parser.add_argument("notebook", type=Path)
    path = parser.parse_args(arguments).notebook
    notebook = json.loads(files.read_text(path))
    for i, (cell, outputs) in enumerate(run(notebook, {"__name__": "notebook"}), 1):
        for output in outputs:
            if "execution_count" in output:
                output["execution_count"] = i
        cell["outputs"], cell["execution_count"] = outputs, i
    files.write_text(path, json.dumps(notebook, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
