"""Structured text (IEC 61131-3) for CODESYS, TwinCAT and other PLCs: one function block, forward and inverse.

The numbers are those of the C (:func:`pcalib.export.c.constants`); `kernel.st` below them is the same for all robots.
"""

from __future__ import annotations

from importlib import resources

import numpy as np

from pcalib.export import Target
from pcalib.export.c import constants
from pcalib.export.rods import Rods, rods_of
from pcalib.export.vectors import vectors
from pcalib.model import Model

TESTED = 20
"""Poses of the self-test: on a PLC they share a few cycles of the task."""
AGREES = 1e-9
"""[m, rad] by which the self-test lets code and answers differ: the least that a machine could resolve, and above what
the trigonometric functions of PLCs leave."""


def write(model: Model) -> dict[str, str]:
    """The files of a model: the function block with its table, and a program that tests it.

    Raises:
        EffectError: the model has an effect that has no closed form.
    """
    rods = rods_of(model)
    return {"PCALIB_Robot.st": code(rods), "PCALIB_SelfTest.st": self_test(rods, model)}


def code(rods: Rods) -> str:
    """The function block, with the functions that it calls above it."""
    kernel = resources.files("pcalib.export").joinpath("kernel.st").read_text(encoding="utf-8")
    numbers, arrays = constants(rods)
    loose = numbers.pop("LOOSE")
    numbers |= {"ROD_SIDE": float(rods.rod_side), "SINGULAR": 1e-14}
    arrays["LOOSE_AXIS"] = np.array([int(loose) >> axis & 1 for axis in range(3)])
    unused = ("RODS_GROW", "ARMS_GROW", "BASE_GROWS", "CLOSE")  # growth of nothing is zero here
    kept = {name: value for name, value in numbers.items() if name not in unused}
    table = [f"    K_{name} : {_sort(value)} := {number(value)};" for name, value in kept.items()]
    table += [_array(f"K_{name}", values) for name, values in arrays.items()]
    hinges = max(len(rods.hinge_point), 1)
    sizes = {"NQ": rods.nq - 1, "M": len(rods.rods) - 1, "H": hinges - 1, "STATE": 5 + hinges}
    for name, size in sizes.items():
        kernel = kernel.replace(f"@{name}@", str(size))
    unit = "rad" if rods.dimension == "angle" else "m"
    kernel = kernel.replace("@UNIT@", unit).replace("@TABLE@", "\n".join(table))
    return f"(* {_comment(rods.name)}: kinematics of the calibrated robot. Written by pcalib. *)\n{kernel}"


def self_test(rods: Rods, model: Model) -> str:
    """A program whose variable `passed` becomes true where the block agrees with the answers of `pcalib`."""
    at, n = vectors(model, TESTED), TESTED
    temp = np.column_stack([at.conditions.columns[f"temp_{part}"] for part in ("rods", "arms", "base")])
    status = np.array([("ok", "not_converged", "wrong_branch").index(s) for s in at.solved.status])
    arrays = {
        "command": at.q, "tool": at.conditions.tool, "temp": temp, "position": at.position, "target": at.target,
        "wanted": at.target_rotation.reshape(n, 9), "joint": np.nan_to_num(at.solved.q), "status": status,
    }  # fmt: skip
    table = "\n".join(_array(f"T_{name}", values) for name, values in arrays.items())
    return TEST.format(table=table, last=n - 1, nq=rods.nq - 1, agrees=number(AGREES))


def number(value: float) -> str:
    """A number as IEC 61131-3 writes it: whole numbers plain, others with a point before the exponent."""
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    text = repr(float(value))
    digits, e, exponent = text.partition("e")
    return digits + (".0" if "." not in digits else "") + ("E" + str(int(exponent)) if e else "")


def _sort(value: float) -> str:
    return "DINT" if isinstance(value, (int, np.integer)) else "LREAL"


def _array(name: str, values: np.ndarray) -> str:
    """An array of one or two dimensions, by rows; a PLC knows no empty one, so that one of zeros stands for it."""
    values = values if values.size else np.zeros((1, *values.shape[1:]), values.dtype)
    bounds = ", ".join(f"0..{size - 1}" for size in values.shape)
    rows = values.reshape(values.shape[0], -1) if values.ndim > 1 else values.reshape(1, -1)
    listed = ",\n        ".join(", ".join(number(v) for v in row.tolist()) for row in rows)
    sort = "DINT" if values.dtype.kind == "i" else "LREAL"
    return f"    {name} : ARRAY[{bounds}] OF {sort} := [\n        {listed}];"


def _comment(text: str) -> str:
    """Text that may stand in a comment: a name must not end it, nor begin one within it."""
    return text.replace("*)", "* )").replace("(*", "( *").replace("\n", " ")


TEST = """\
(* Compares PCALIB_Robot with what pcalib computes. Run it in any task: passed becomes TRUE, or wrong and worst say
   why. *)
PROGRAM PCALIB_SelfTest
VAR CONSTANT
{table}
END_VAR
VAR
    robot : PCALIB_Robot;
    pose : DINT;
    i : DINT;
    found : DINT;
    wrong : DINT; (* statuses that differ *)
    worst : LREAL; (* largest difference [m, rad] *)
    passed : BOOL;
END_VAR
wrong := 0;
worst := 0.0;
FOR pose := 0 TO {last} DO
    FOR i := 0 TO 2 DO
        robot.tool[i] := T_tool[pose, i];
        robot.target[i] := T_target[pose, i];
    END_FOR
    FOR i := 0 TO 8 DO
        robot.wanted[i] := T_wanted[pose, i];
    END_FOR
    FOR i := 0 TO {nq} DO
        robot.command[i] := T_command[pose, i];
    END_FOR
    robot.temp_rods := T_temp[pose, 0];
    robot.temp_arms := T_temp[pose, 1];
    robot.temp_base := T_temp[pose, 2];
    robot.backward := FALSE;
    robot();
    IF robot.status <> 0 THEN
        wrong := wrong + 1;
    END_IF
    FOR i := 0 TO 2 DO
        worst := MAX(worst, ABS(robot.position[i] - T_position[pose, i]));
    END_FOR
    robot.backward := TRUE;
    robot();
    found := robot.status;
    IF found = 3 THEN
        found := 0;
    END_IF
    IF found <> T_status[pose] THEN
        wrong := wrong + 1;
    END_IF
    IF found = 0 THEN
        FOR i := 0 TO {nq} DO
            worst := MAX(worst, ABS(robot.joint[i] - T_joint[pose, i]));
        END_FOR
    END_IF
END_FOR
passed := wrong = 0 AND worst <= {agrees};
END_PROGRAM
"""

TARGET = Target(
    "structured text for PLCs (CODESYS, TwinCAT): one function block, with a self-test", write,
    "import {folder}/PCALIB_Robot.st into the PLC project, and run PCALIB_SelfTest once",
)  # fmt: skip
