"""C99 for controllers: forward and inverse kinematics of the calibrated robot in one file, without dependencies.

The numbers of the model are a table at the top of the file; below it stand `kernel.c`, which also solves batches in
:mod:`pcalib.mechanics.native`, and `controller.c`, the same for all robots.
"""

from __future__ import annotations

from importlib import resources

import numpy as np

from pcalib.export import Target
from pcalib.export.rods import Rods, rods_of
from pcalib.export.vectors import Vectors, vectors
from pcalib.mechanics.kinematics import Solution
from pcalib.model import Model

STATUS = {"ok": "PCALIB_OK", "not_converged": "PCALIB_NOT_CONVERGED", "wrong_branch": "PCALIB_WRONG_BRANCH"}
ROUNDS = 40
"""Newton steps at most, as in `pcalib.mechanics.kinematics`."""
NEARLY = 1e-9
"""[m] loop error from which one more step leaves rounding alone."""
CLOSE = 2e-15
"""[m] loop error that is rounding alone: some units in the last place of a metre."""
AGREES = 1e-11
"""[m, rad] by which the self-test lets code and answers differ: ten times what was seen on all kinds of robots."""

HEADER = """\
/* {name}: a calibrated robot of kind {kind}, {nq} drives and {m} rods. Written by pcalib; see pcalib_robot.c. */
#ifndef PCALIB_ROBOT_H
#define PCALIB_ROBOT_H

#ifdef __cplusplus
extern "C" {{
#endif

enum {{
    PCALIB_OK = 0,
    PCALIB_NOT_CONVERGED = 1,      /* the target cannot be reached, or the loops do not close */
    PCALIB_WRONG_BRANCH = 2,       /* the loops close with the plate turned over or rods on the wrong side */
    PCALIB_OUTSIDE_JOINT_RANGE = 3 /* inverse only: the commands are right, and beyond {least:g} to {most:g} {unit} */
}};

#define PCALIB_DRIVES {nq}

/* Temperatures in degrees Celsius{unused}. */
typedef struct {{
    double temp_rods, temp_arms, temp_base;
}} pcalib_conditions;

/* Lengths in metres, rotations as matrices by rows (plate to base), in the robot's base frame. */
typedef struct {{
    double position[3]; /* tool point */
    double plate[3];    /* origin of the plate */
    double rotation[9];
}} pcalib_pose;

/* Where the tool point is for commands q [{unit}]. tool [m] is the tool point in the plate's frame. conditions may be
 * null where no temperature is known: all parts then have 20 degrees. */
int pcalib_forward(
    const double q[{nq}], const double tool[3], const pcalib_conditions *conditions, pcalib_pose *pose);

/* Commands q [{unit}] that bring the tool point to a position [m]. rotation is {rotation};
 * null stands for the plate unturned. q is written in all cases, and is to be used where the status is PCALIB_OK. */
int pcalib_inverse(
    const double position[3], const double *rotation, const double tool[3], const pcalib_conditions *conditions,
    double q[{nq}]);

#ifdef __cplusplus
}}
#endif
#endif
"""


def write(model: Model) -> dict[str, str]:
    """The files of a model: code, header, self-test with its vectors, and how to run it."""
    rods = rods_of(model)
    return {
        "pcalib_robot.h": header(rods), "pcalib_robot.c": code(rods), "self_test.c": self_test(rods, vectors(model)),
        "Makefile": MAKEFILE,
    }  # fmt: skip


def header(rods: Rods) -> str:
    """The header file."""
    chosen = {3: "rx", 4: "ry", 5: "rz"}
    axes = " ".join(name for c, name in chosen.items() if c in rods.task)
    grow = rods.rod_growth.any() or rods.arm_growth.any() or rods.base_growth.any()
    return HEADER.format(
        name=_comment(rods.name), kind=rods.kind, nq=rods.nq, m=len(rods.rods), least=rods.joint_range[0],
        most=rods.joint_range[1], unit="rad" if rods.dimension == "angle" else "m",
        unused="" if grow else "; this model does not depend on them",
        rotation=f"the matrix of the plate's turn, of which {axes} counts" if axes else
        "a start for the plate's turn, which no drive commands",
    )  # fmt: skip


def code(rods: Rods) -> str:
    """The code: table and kernel."""
    folder = resources.files("pcalib.export")
    parts = [folder.joinpath(name).read_text(encoding="utf-8") for name in ("kernel.c", "controller.c")]
    return "\n".join([table(rods), *parts])


def table(rods: Rods) -> str:
    """The model's numbers as C."""
    numbers, arrays = constants(rods)
    if not len(rods.hinge_point):  # C knows no empty arrays
        arrays = {name: values for name, values in arrays.items() if name not in ("BODY", "HINGE_POINT", "HINGE_AXIS")}
    return (
        f"/* {_comment(rods.name)}: forward and inverse kinematics of the calibrated robot. Written by pcalib.\n"
        " * C99; cc -O3 -c pcalib_robot.c; needs <math.h> and <string.h> only. self_test.c tries it. */\n"
        '#include "pcalib_robot.h"\n\n#include <math.h>\n#include <string.h>\n\n'
        + "\n".join(f"#define {name} ({value!r})" for name, value in numbers.items())
        + "\n\n/* ---- the calibrated robot [m, rad, 1/K] ---- */\n\n"
        + "\n".join(_array(name, values) for name, values in arrays.items())
    )


def constants(rods: Rods) -> tuple[dict[str, int | float], dict[str, np.ndarray]]:
    """What a kernel knows of a robot: single numbers and arrays by name, the same for every language."""
    free = [c for c, dof in enumerate(rods.dofs) if dof not in rods.task]
    hinges = len(rods.hinge_point)
    free += list(range(len(rods.dofs), len(rods.dofs) + hinges))
    commanded = {3, 4, 5} & set(rods.task)
    tilt_free = 0 if {3, 4} <= commanded else 1 if commanded else 2
    keep_yaw = 5 in commanded and not {3, 4} & commanded and len(rods.dofs) == 6
    loose = sum(1 << d for d in rods.dofs if d < 3 and d not in rods.task)
    waves = list(rods.waves.items()) or [(1, (np.zeros(rods.nq), np.zeros(rods.nq)))]
    numbers = {
        "NQ": rods.nq, "M": len(rods.rods), "H": hinges, "ND": len(rods.dofs), "WAVES": len(rods.waves),
        "ROUNDS": ROUNDS, "NEARLY": NEARLY, "CLOSE": CLOSE, "PI": float(np.pi), "TURNS": int(rods.dimension == "angle"),
        "RODS_GROW": int(rods.rod_growth.any()), "ARMS_GROW": int(rods.arm_growth.any()),
        "BASE_GROWS": int(rods.base_growth.any()), "TILT_FREE": tilt_free, "KEEP_YAW": int(keep_yaw), "LOOSE": loose,
        "ROD_SIDE": rods.rod_side, "MAX_TILT": float(rods.max_tilt), "Q_MIN": rods.joint_range[0],
        "Q_MAX": rods.joint_range[1],
    }  # fmt: skip
    arrays = {
        "ACTUATOR": rods.actuator, "BODY": rods.body, "GUIDED": rods.guided.astype(int), "DOF": np.array(rods.dofs),
        "FREE": np.array(free or [0]), "CENTRE": rods.centre, "COSINE": rods.cosine, "SINE": rods.sine,
        "SLOPE": rods.slope, "PIVOT": rods.pivot, "LENGTH": rods.length, "RATE": rods.rate, "PLATE": rods.plate,
        "GUIDE_COSINE": rods.guide_cosine, "GUIDE_SINE": rods.guide_sine, "GUIDE_LENGTH": rods.guide_length,
        "HINGE_POINT": rods.hinge_point, "HINGE_AXIS": rods.hinge_axis, "RATIO": rods.ratio,
        "CYCLES": np.array([float(n) for n, _ in waves]), "WAVE_SINE": np.array([sine for _, (sine, _) in waves]),
        "WAVE_COSINE": np.array([cosine for _, (_, cosine) in waves]), "ROD_GROWTH": rods.rod_growth,
        "ARM_GROWTH": rods.arm_growth, "BASE_GROWTH": rods.base_growth, "START": rods.start,
    }  # fmt: skip
    return numbers, arrays


def _array(name: str, values: np.ndarray) -> str:
    """An array of one or two dimensions, by rows; numbers are written so that they are read back as they are."""
    sort = "int" if values.dtype.kind == "i" else "double"
    shape = "".join(f"[{n}]" for n in values.shape)

    def row(v: np.ndarray) -> str:
        return "{" + ", ".join(repr(x) for x in v.tolist()) + "}"

    body = row(values) if values.ndim == 1 else "{\n    " + ",\n    ".join(row(v) for v in values) + "}"
    return f"static const {sort} {name}{shape} = {body};"


def _comment(text: str) -> str:
    """Text that may stand in a comment: a name must not end it."""
    return text.replace("*/", "* /").replace("\n", " ")


def self_test(rods: Rods, at: Vectors) -> str:
    """A program that compares the code with the answers of `pcalib`; exit 0 where they agree."""
    columns = [at.conditions.columns[f"temp_{part}"] for part in ("rods", "arms", "base")]
    n = len(at.q)
    rows = np.column_stack([
        at.q, at.conditions.tool, *columns, at.position, at.rotation.reshape(n, 9), at.target,
        at.target_rotation.reshape(n, 9), np.nan_to_num(at.solved.q),
    ])  # fmt: skip
    numbers = ",\n".join("    {" + ", ".join(repr(x) for x in row) + "}" for row in rows.tolist())
    status = ", ".join(STATUS[s] for s in _statuses(at.solved))
    return TEST.format(nq=rods.nq, n=n, width=rows.shape[1], numbers=numbers, status=status, agrees=AGREES)


def _statuses(solved: Solution) -> list[str]:
    return [str(s) for s in solved.status]


TEST = """\
/* Compares pcalib_robot.c with what pcalib computes for {n} poses. Exit 0: they agree. */
#include "pcalib_robot.h"

#include <math.h>
#include <stdio.h>

/* commands, tool, temperatures, position and rotation that they lead to; a target's position and rotation, commands */
static const double POSES[{n}][{width}] = {{
{numbers}}};
static const int STATUS[{n}] = {{{status}}};

static double worst = 0.0;

static void compare(const double *a, const double *b, int n)
{{
    int i;
    for (i = 0; i < n; i++)
        if (!(fabs(a[i] - b[i]) <= worst)) worst = fabs(a[i] - b[i]);
}}

int main(void)
{{
    int i, wrong = 0;
    for (i = 0; i < {n}; i++) {{
        const double *q = POSES[i], *tool = q + {nq}, *temp = tool + 3, *position = temp + 3, *turn = position + 3;
        const double *target = turn + 9, *wanted = target + 3, *command = wanted + 9;
        const pcalib_conditions at = {{temp[0], temp[1], temp[2]}};
        pcalib_pose pose;
        double found[{nq}];
        int status = pcalib_forward(q, tool, &at, &pose);
        if (status != PCALIB_OK) wrong++;
        compare(pose.position, position, 3);
        compare(pose.rotation, turn, 9);
        status = pcalib_inverse(target, wanted, tool, &at, found);
        if (status == PCALIB_OUTSIDE_JOINT_RANGE) status = PCALIB_OK;
        if (status != STATUS[i]) wrong++;
        if (status == PCALIB_OK) compare(found, command, {nq});
    }}
    printf("%d poses: largest difference %.1e m or rad, %d wrong statuses\\n", {n}, worst, wrong);
    return wrong || !(worst <= {agrees!r});
}}
"""
MAKEFILE = """\
# make test: compiles the code and compares it with pcalib's own answers
CFLAGS ?= -O3 -std=c99 -Wall -Wextra -Werror -pedantic

test: self_test
	./self_test

self_test: self_test.c pcalib_robot.c pcalib_robot.h
	$(CC) $(CFLAGS) -o $@ self_test.c pcalib_robot.c -lm

clean:
	rm -f self_test
"""

TARGET = Target(
    "C99 for a controller: forward and inverse kinematics, with a self-test", write, "make -C {folder} test"
)  # fmt: skip
