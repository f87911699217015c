"""A kinematics module for LinuxCNC: the exported C with LinuxCNC's own functions around it, in one file.

Positions are in millimetres; joints are in degrees where drives turn, else in millimetres. The tool point and the
temperatures are HAL pins. Robots that tilt their plate take a, b, c [deg] as R = Rz(c)·Ry(b)·Rx(a), as genhexkins does.
"""

from __future__ import annotations

import re

from pcalib.export import Target, c
from pcalib.export.rods import rods_of
from pcalib.model import Model

NAME = "pcalibkins"

WRAPPER = """
/* ---- LinuxCNC: millimetres and degrees outside, metres and radians inside ------------------------------------- */

#include "rtapi.h"
#include "rtapi_app.h"
#include "hal.h"
#include "kinematics.h"

#define DEGREES (PI / 180.0)
#define JOINT {joint}

typedef struct {{
    hal_float_t *tool[3], *temp[3];
}} pins;

static pins *hal = 0;
static int component = -1;

static void outside(double tool[3], pcalib_conditions *at)
{{
    int i;
    for (i = 0; i < 3; i++) tool[i] = hal ? 1e-3 * *hal->tool[i] : 0.0;
    at->temp_rods = hal ? *hal->temp[0] : 20.0;
    at->temp_arms = hal ? *hal->temp[1] : 20.0;
    at->temp_base = hal ? *hal->temp[2] : 20.0;
}}

/* R = Rz(c) Ry(b) Rx(a), by rows */
static void turned(double a, double b, double c, double R[9])
{{
    const double X[3] = {{a, 0, 0}}, Y[3] = {{0, b, 0}}, Z[3] = {{0, 0, c}};
    double Rx[9], Ry[9], Rz[9], Rzy[9];
    exp3(X, Rx);
    exp3(Y, Ry);
    exp3(Z, Rz);
    matmul3(Rz, Ry, Rzy);
    matmul3(Rzy, Rx, R);
}}

int kinematicsForward(
    const double *joint, struct EmcPose *world, const KINEMATICS_FORWARD_FLAGS *fflags,
    KINEMATICS_INVERSE_FLAGS *iflags)
{{
    double q[NQ], tool[3];
    pcalib_conditions at;
    pcalib_pose pose;
    int i, status;
    (void)fflags;
    (void)iflags;
    outside(tool, &at);
    for (i = 0; i < NQ; i++) q[i] = joint[i] * JOINT;
    status = pcalib_forward(q, tool, &at, &pose);
    if (status != PCALIB_OK) return -status;
    world->tran.x = 1e3 * pose.position[0];
    world->tran.y = 1e3 * pose.position[1];
    world->tran.z = 1e3 * pose.position[2];
    world->a = {tilts} ? atan2(pose.rotation[7], pose.rotation[8]) / DEGREES : 0.0;
    world->b = {tilts} ? atan2(-pose.rotation[6], sqrt(pose.rotation[7] * pose.rotation[7]
                                                       + pose.rotation[8] * pose.rotation[8])) / DEGREES : 0.0;
    world->c = {yaws} ? atan2(pose.rotation[3], pose.rotation[0]) / DEGREES : 0.0;
    return 0;
}}

int kinematicsInverse(
    const struct EmcPose *world, double *joint, const KINEMATICS_INVERSE_FLAGS *iflags,
    KINEMATICS_FORWARD_FLAGS *fflags)
{{
    const double position[3] = {{1e-3 * world->tran.x, 1e-3 * world->tran.y, 1e-3 * world->tran.z}};
    double R[9], q[NQ], tool[3];
    pcalib_conditions at;
    int i, status;
    (void)fflags;
    (void)iflags;
    outside(tool, &at);
    turned({tilts} * DEGREES * world->a, {tilts} * DEGREES * world->b, {yaws} * DEGREES * world->c, R);
    status = pcalib_inverse(position, R, tool, &at, q);
    if (status != PCALIB_OK) return -status;
    for (i = 0; i < NQ; i++) joint[i] = q[i] / JOINT;
    return 0;
}}

KINEMATICS_TYPE kinematicsType(void) {{ return KINEMATICS_BOTH; }}

KINS_NOT_SWITCHABLE
EXPORT_SYMBOL(kinematicsType);
EXPORT_SYMBOL(kinematicsForward);
EXPORT_SYMBOL(kinematicsInverse);

int rtapi_app_main(void)
{{
    static const char *const axis[3] = {{"x", "y", "z"}}, *const part[3] = {{"rods", "arms", "base"}};
    int i, failed = 0;
    component = hal_init("{name}");
    if (component < 0) return component;
    hal = hal_malloc(sizeof *hal);
    if (!hal) return -1;
    for (i = 0; i < 3; i++) {{
        failed |= hal_pin_float_newf(HAL_IN, &hal->tool[i], component, "{name}.tool-%s", axis[i]);
        failed |= hal_pin_float_newf(HAL_IN, &hal->temp[i], component, "{name}.temp-%s", part[i]);
        if (!failed) *hal->tool[i] = 0.0, *hal->temp[i] = 20.0;
    }}
    if (failed) {{
        hal_exit(component);
        return -1;
    }}
    hal_ready(component);
    return 0;
}}

void rtapi_app_exit(void) {{ hal_exit(component); }}
"""


def write(model: Model) -> dict[str, str]:
    """The file of a model.

    Raises:
        EffectError: the model has an effect that has no closed form.
    """
    rods = rods_of(model)
    header = c.header(rods)
    code = c.code(rods).replace('#include "pcalib_robot.h"\n', header)
    code = re.sub(r"^int (pcalib_(?:forward|inverse)\()", r"static int \1", code, flags=re.MULTILINE)
    wrapper = WRAPPER.format(
        name=NAME, joint="DEGREES" if rods.dimension == "angle" else "1e-3", tilts=int({3, 4} <= set(rods.task)),
        yaws=int(5 in rods.task),
    )  # fmt: skip
    return {f"{NAME}.c": code + wrapper}


TARGET = Target(
    "a kinematics module for LinuxCNC, in millimetres and degrees", write,
    "sudo halcompile --install {folder}/pcalibkins.c   (then 'loadrt pcalibkins' in the machine's HAL file)",
)  # fmt: skip
