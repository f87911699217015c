"""The virtual robot: it turns commands into poses, by MuJoCo alone.

    machine = Machine(robot, values)             # a robot file, and the true values of its geometric parameters
    landing = machine.land(q, tool=[0, 0, -0.3]) # joint commands (N, nq) [rad] → poses, TCPs and a status per row

A machine is one compiled MjModel. The order of things for one row, and what a fault (bench/faults/) may change:

1. geometry   parameter values of this row             thermal growth
2. shaft      where the motor shafts really are        encoder, gear
3. prepare    base, gravity, springs and forces        base drift, tilt
4. solve      closed loops; with springs, equilibrium  whatever joints a fault has built into the MjSpec
5. settle     sides of gaps by load, then 4 again      backlash, clearance
6. mount      where the TCP is in the tool's frame     creep of the tool mount

Every row is solved from the same home pose, so that no row depends on another: any split over workers gives the same
bits. Newton starts at home with the motors moved; where that ends on another branch, or nowhere, the motors are
walked there in small steps before the pose is given up.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from bench import kinds
from bench.closing import Closed
from bench.commands import Commands, Landing, Row
from bench.faults import Fault, present
from bench.geometry import Geometry
from bench.rig import Rig
from pcalib.errors import InputError, ReachError, unknown
from pcalib.robot import Robot

WALKS = (4, 24)
"""Steps from home to the command when the direct way fails."""
SIDES = 20
"""How often the sides of gaps may change before a row is given up."""
JOINT_SLACK = 1e-9
"""[rad or m] by which a command may pass a joint limit: rounding of files."""


class Machine:
    """One robot of given true geometry.

    Args:
        robot: nominal robot.
        values: true parameters, by name (others nominal) or as a vector (nk,) in the robot's order [m, rad].
        faults: what else is wrong with it; those of size zero are left out.
        variant: which model of the kind, 'rods' or a cross-check such as 'tendons'.

    Raises:
        InputError: unknown parameter or variant.
        ReachError: such a robot cannot be assembled in its home pose.
    """

    def __init__(
        self,
        robot: Robot,
        values: Mapping[str, float] | np.ndarray | None = None,
        faults: Sequence[Fault] = (),
        *,
        variant: str = "rods",
    ):
        self.robot = robot
        self.kind = kinds.get(robot.kind)
        if variant not in self.kind.variants:
            raise InputError(unknown("variant", variant, self.kind.variants))
        maker = self.kind.variants[variant]
        spec = maker.spec(robot)
        self.faults = present(faults)
        for fault in self.faults:
            fault.springs.clear()
            fault.held.clear()
            fault.build(spec)
        self.rig = Rig(
            robot,
            spec,
            springs=[joint for fault in self.faults for joint in fault.springs],
            held=[joint for fault in self.faults for joint in fault.held],
            loaded=any(fault.loaded for fault in self.faults),
        )
        self.model, self.loops = self.rig.model, self.rig.loops
        self.geometry = Geometry(self.model, robot.mechanism.parameters, maker.places(robot))
        self.k = parameter_vector(robot, values)
        """(nk,) true geometry."""

        model = self.model
        self._plate, self._tool = model.body("plate").id, model.body("tool").id
        # What the mechanism counts as a rod may be a constraint without a body, such as the drive of a driven rod.
        self._rods = [r for r in robot.mechanism.rods if has(model, mujoco.mjtObj.mjOBJ_SITE, f"b{r}")]
        self._plate_sites = [model.site(f"b{r}").id for r in self._rods]
        self._bodies = has(model, mujoco.mjtObj.mjOBJ_BODY, f"rod{self._rods[0]}")
        self._anchors = [model.body(f"rod{r}").id if self._bodies else model.site(f"a{r}").id for r in self._rods]
        self._least_cosine = math.cos(self.kind.max_turn(robot))
        self._assemble()

    # -- solving -------------------------------------------------------------------------------------------------

    def _assemble(self) -> None:
        """Assemble the robot in its home pose: rods aimed at the plate, then Newton, nominal first and then true."""
        home = self.kind.home(self.robot)
        model, data, loops = self.model, self.loops.data, self.loops
        plate = model.joint("plate").qposadr[0]
        data.qpos[plate : plate + 3] = home.x
        mujoco.mju_mat2Quat(data.qpos[plate + 3 : plate + 7], home.R.ravel())
        self._home_R, self._home_sign = home.R, 0.0
        at_home = np.zeros(len(loops.driven_qpos))
        at_home[: self.rig.actuators] = home.q
        for k in (self.robot.mechanism.nominal, self.k):
            self.geometry.write(k)
            self._written = k
            loops.drive(at_home)
            if self._bodies:
                self._aim_rods()
            closed = loops.close()
            self._home_sign = closed.orientation
            if not self.fits(closed):
                raise ReachError(
                    f"the robot '{self.robot.name}' with this geometry cannot be assembled in its home pose, joints at "
                    f"{', '.join(f'{v:.4g}' for v in home.q)}: check the geometric errors and the robot file"
                )
        self._home = data.qpos.copy()

    def _aim_rods(self) -> None:
        """Turn the two hinges of every rod that has them so that it points at its plate anchor."""
        model, data = self.model, self.loops.data
        free = [i for i, r in enumerate(self._rods) if has(model, mujoco.mjtObj.mjOBJ_JOINT, f"rod{r}.x")]
        hinges = np.array([[model.joint(f"rod{self._rods[i]}.{axis}").qposadr[0] for axis in "xy"] for i in free])
        anchors = np.array(self._anchors)[free]
        data.qpos[hinges] = 0.0
        mujoco.mj_kinematics(model, data)
        to_plate = data.site_xpos[np.array(self._plate_sites)[free]] - data.xpos[anchors]
        frames = data.xmat[anchors].reshape(-1, 3, 3)
        d = np.einsum("rji,rj->ri", frames, to_plate)
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        # Rx(α)·Ry(γ)·(0, 0, −1) = (−sin γ, sin α cos γ, −cos α cos γ)
        data.qpos[hinges[:, 0]] = np.arctan2(d[:, 1], -d[:, 2])
        data.qpos[hinges[:, 1]] = -np.arcsin(np.clip(d[:, 0], -1, 1))

    def go_home(self) -> None:
        """Put `data` back to the home pose."""
        self.loops.data.qpos[:] = self._home

    def fits(self, closed: Closed) -> bool:
        """Return whether the pose in `data` is closed and on the working branch: guards that need no kinematic
        model."""
        return closed.ok and closed.orientation == self._home_sign and self._hangs_well()

    def _hangs_well(self) -> bool:
        """Return whether the rods hang down and the plate is hardly turned."""
        data = self.loops.data
        if self.kind.rods_down:
            top = (data.xpos if self._bodies else data.site_xpos)[self._anchors, 2]
            if (data.site_xpos[self._plate_sites, 2] >= top).any():
                return False
        cosine = 0.5 * (data.xmat[self._plate].dot(self._home_R.ravel()) - 1.0)
        return cosine >= self._least_cosine

    def _solve(self, row: Row, miss: np.ndarray | None = None) -> str:
        """Bring `data` to the pose of one command; its status."""
        rig, k = self.rig, self.k
        theta = row.q if miss is None else row.q + miss
        for fault in self.faults:
            k = fault.geometry(k, row)
            theta = fault.shaft(theta, row)
        if k is not self._written:
            self.geometry.write(k)
            self._written = k
        rig.prepare(row, theta)
        for fault in self.faults:
            fault.prepare(rig, row)
        seen = set()
        while (status := self._rest(again=bool(seen))) == "ok":
            # All faults look before the row is solved again, so that their order does not matter.
            if not any([fault.settle(rig, row) for fault in self.faults]):
                return "ok"
            state = rig.driven.tobytes()
            if state in seen or len(seen) > SIDES:  # the load pushes a gap shut from either side: it hangs between
                return "not_converged"
            seen.add(state)
        return status

    def _rest(self, again: bool) -> str:
        """Return closed loops and, where there are forces to balance, equilibrium from there; `again`: of the same
        row."""
        status = self._close()
        if status == "ok" and self.rig.equilibrium is not None:
            if not self.rig.equilibrium.settle(again).ok:
                return "not_converged"
            if not self._hangs_well():
                return "wrong_branch"
        return status

    def _close(self) -> str:
        """Close the loops for the driven joints, all springs unstretched."""
        loops, target = self.loops, self.rig.driven
        self.go_home()
        loops.drive(target)
        closed = loops.close()
        if self.fits(closed):
            return "ok"
        start = self._home[loops.driven_qpos]
        for steps in WALKS:
            self.go_home()
            for s in range(1, steps + 1):
                loops.drive(start + (target - start) * (s / steps))
                closed = loops.close()
                if not self.fits(closed):
                    break
            else:
                return "ok"
        return "wrong_branch" if closed.ok else "not_converged"

    # -- use -----------------------------------------------------------------------------------------------------

    def run(self, commands: Commands, miss: np.ndarray | None = None) -> Landing:
        """Carry out commands one by one.

        Args:
            miss: (N, nq) [rad or m] by which the drives fail to repeat themselves.

        Nothing is raised for a pose that cannot be reached: its status says why, and its pose is NaN.
        """
        low, high = self.robot.joint_range
        n, data = len(commands), self.loops.data
        status = np.full(n, "ok", dtype="<U13")
        status[((commands.q < low - JOINT_SLACK) | (commands.q > high + JOINT_SLACK)).any(axis=1)] = "joint_limit"
        status[~np.isfinite(commands.q).all(axis=1)] = "not_converged"
        x, flange = np.full((2, n, 3), np.nan)
        R, turn = np.full((2, n, 9), np.nan)
        tool = commands.tool.copy()
        for fault in self.faults:
            commands.need(fault.NEEDS, f"fault '{fault.name}'")
            commands = commands.remembering(fault.history(commands))
        for i, row in enumerate(commands):
            if status[i] != "ok":
                continue
            status[i] = self._solve(row, None if miss is None else miss[i])
            if status[i] == "ok":
                x[i], R[i] = data.xpos[self._plate], data.xmat[self._plate]
                flange[i], turn[i] = data.xpos[self._tool], data.xmat[self._tool]
                for fault in self.faults:
                    tool[i] = fault.mount(tool[i], row)
        tcp = flange + (turn.reshape(n, 3, 3) @ tool[:, :, None])[:, :, 0]
        return Landing(x, R.reshape(n, 3, 3), tcp, status)

    def land(self, q: np.ndarray, tool: np.ndarray | float = 0.0) -> Landing:
        """Return poses and TCPs for joint commands (N, nq) [rad or m] with a tool (3,) or (N, 3) [m, plate frame]."""
        return self.run(Commands.of(q, tool))


def has(model: mujoco.MjModel, what: mujoco.mjtObj, name: str) -> bool:
    """Return whether a model has an element of that name."""
    return mujoco.mj_name2id(model, what, name) >= 0


def parameter_vector(robot: Robot, values: Mapping[str, float] | np.ndarray | None) -> np.ndarray:
    """Return the vector k (nk,) [m, rad] of named values, others nominal.

    Raises:
        InputError: a name that the robot does not have, or a vector of another length.
    """
    mechanism = robot.mechanism
    if values is None:
        return mechanism.nominal.copy()
    if isinstance(values, Mapping):
        k = mechanism.nominal.copy()
        for name, value in values.items():
            if name not in mechanism.parameters:
                raise InputError(unknown("geometric parameter", name, mechanism.parameters))
            k[mechanism.parameters.index(name)] = value
        return k
    k = np.array(values, float)
    if k.shape != mechanism.nominal.shape:
        raise InputError(f"{k.size} parameter values for a robot that has {mechanism.nominal.size}")
    return k
