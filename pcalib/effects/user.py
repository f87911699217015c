"""Effects of the user's own, from a Python file that the user names: ``file.py:ClassName``.

Code is run only from a file that was named on the command line or in a call. What it returns is checked when it is
loaded and again every time it is used, so that a slip is reported with the file and line, never as a wrong number.
"""

from __future__ import annotations

import importlib.util
import re
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np

from pcalib import files, units
from pcalib.effects.base import Contribution, Effect, EffectParameter, Situation
from pcalib.effects.library import LIBRARY
from pcalib.errors import EffectError, InputError, unknown
from pcalib.mechanics.mechanism import Mechanism
from pcalib.robot import Robot

TEMPLATE = '''"""{title}: say here what happens, in one line."""

import numpy as np

from pcalib.effects import Contribution, Effect, EffectParameter


class {classname}(Effect):
    name = "{name}"
    parameters = (EffectParameter("amplitude", "urad", 1e-4),)  # name, unit that is shown, usual size in SI
    needs = ()  # columns of the data that it uses, e.g. ("humidity",): at.column("humidity")

    def contribution(self, at, theta):
        """Added to each motor angle [rad], nothing at theta = 0; `at` also has torque, tension, payload, pose."""
        return Contribution(actuator=theta[0] * np.sin(40 * at.q))
'''


def template(name: str) -> tuple[str, str, str]:
    """File name, class name and text of a new effect called `name` (snake_case or CamelCase)."""
    words = re.findall(r"[A-Z]?[a-z0-9]+|[A-Z]+(?![a-z])", name)
    if not words or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise EffectError(f"'{name}' cannot name an effect\n  use letters, digits and _, e.g. worm_gear")
    snake = "_".join(w.lower() for w in words)
    camel = "".join(w[0].upper() + w[1:] for w in words)
    title = " ".join(w.lower() for w in words).capitalize()
    return f"{snake}.py", camel, TEMPLATE.format(title=title, classname=camel, name=snake)


class _Located(EffectError):
    """An error that names the user's file already."""


class UserEffect(Effect):
    """The checks in front of a user's class, which :func:`load` adds as the second base."""

    file: Path
    kind: type
    """The user's class itself."""

    def contribution(self, at: Situation, theta: np.ndarray) -> Contribution:
        """That of the user's class, checked.

        Raises:
            EffectError: it raises, or returns another type, a wrong shape, NaN or infinity.
        """
        run = super().contribution
        return self._checked(self._called("contribution", lambda: run(at, np.array(theta, float))), at)

    def basis(self, at: Situation, theta: np.ndarray | None = None) -> list[Contribution]:
        run = super().basis
        return [self._checked(part, at) for part in self._called("basis", lambda: list(run(at, theta)))]

    def through(self, at: Situation, theta: np.ndarray, other: Effect, other_theta: np.ndarray) -> list[Contribution]:
        run = super().through
        return [self._checked(p, at) for p in self._called("through", lambda: list(run(at, theta, other, other_theta)))]

    def unsuited(self, mechanism: Mechanism) -> str:
        run = super().unsuited
        return str(self._called("unsuited", lambda: run(mechanism)))

    def describe(self, theta: np.ndarray) -> str:
        run = super().describe
        return str(self._called("describe", lambda: run(np.array(theta, float))))

    def _called(self, method: str, run: Callable[[], Any]) -> Any:
        return _call(self.file, f"{self.kind.__name__}.{method}", run)

    def _checked(self, got: Any, at: Situation) -> Contribution:
        if not isinstance(got, Contribution):
            raise self.error(
                f"contribution returned {type(got).__name__}, not Contribution",
                "write e.g. return Contribution(actuator=theta[0] * at.torque)",
            )
        N, nq, m = *at.q.shape, at.tension.shape[1]
        shapes = {"actuator": (N, nq), "rod": (N, m), "elbow": (N, m, 3), "plate": (N, m, 3), "tool": (N, 3)}
        shapes |= {"base": (N, 6), "sensor": (N, 3)}
        out: dict[str, np.ndarray] = {}
        for channel, value in got.items():
            try:
                value = np.asarray(value, float)
            except (TypeError, ValueError):
                raise self.error(f"{channel} is not an array of numbers: {value!r}") from None
            if value.shape != shapes[channel]:
                raise self.error(
                    f"{channel} has shape {value.shape}, not {shapes[channel]}",
                    f"{N} poses, {nq} actuators, {m} rods; poses stand on the first axis",
                )
            bad = np.argwhere(~np.isfinite(value))
            if len(bad):
                raise self.error(
                    f"{channel} is not finite at pose {bad[0][0]} (and {len(bad) - 1} more values)",
                    "look for a division by zero, a root or logarithm of a negative number, or blanks in a column",
                )
            out[channel] = value
        return Contribution(**out)

    def error(self, problem: str, remedy: str = "") -> EffectError:
        """An error of the user's class, with the line of its `contribution`."""
        code = vars(self.kind).get("contribution")
        line = f":{code.__code__.co_firstlineno}" if isinstance(code, FunctionType) else ""
        remedy = f"\n  {remedy}" if remedy else ""
        return _Located(f"{self.file}{line}: {self.kind.__name__}: {problem}{remedy}")


def load(spec: str, robot: Robot | None = None) -> UserEffect:
    """The effect of a file the user named, checked; with a robot it is also tried on poses of that robot.

    Raises:
        EffectError: the file, class or what the class does cannot be used; the message names file and line.
    """
    path, _, classname = spec.rpartition(":")
    if not path.endswith(".py"):
        raise EffectError(f"'{spec}' does not name a class in a Python file\n  write file.py:ClassName")
    try:
        files.read_text(path)
    except InputError as error:
        raise EffectError(str(error)) from None
    file = Path(path)
    module = _module(file)
    kind = getattr(module, classname, None)
    if not isinstance(kind, type):
        classes = {n: v for n, v in vars(module).items() if isinstance(v, type) and v.__module__ == module.__name__}
        have = [name for name, each in classes.items() if hasattr(each, "contribution")]
        raise EffectError(f"{file}: " + unknown("class", classname, have or ["none has a method 'contribution'"]))
    if not callable(getattr(kind, "contribution", None)) or kind.contribution is Effect.contribution:
        remedy = "'pcalib effect new NAME' writes a template"
        raise EffectError(f"{file}: {classname}: has no method contribution(self, at, theta)\n  {remedy}")
    stated = {"file": file, "kind": kind, "spec": spec, "linear": False, "channels": (), "__module__": kind.__module__}
    effect = _call(file, classname, lambda: type(classname, (UserEffect, kind, Effect), stated)())
    _declared(effect)
    if robot is not None:
        _try(effect, robot)
    return effect


def _module(file: Path) -> Any:
    name = f"_pcalib_user_effect_{file.stem}"
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise EffectError(f"{file}: cannot be read as Python")
    module = importlib.util.module_from_spec(spec)
    loader = spec.loader
    sys.modules[name] = module  # dataclasses look their module up there
    before = sys.dont_write_bytecode
    sys.dont_write_bytecode = True
    try:
        _call(file, "loading", lambda: loader.exec_module(module))
    finally:
        sys.dont_write_bytecode = before
    return module


def _call(file: Path, what: str, run: Callable[[], Any]) -> Any:
    """Run the user's code; whatever it raises becomes an EffectError with the line of the user's file."""
    try:
        with np.errstate(all="ignore"):  # what is not finite is reported with file and pose instead
            return run()
    except _Located:
        raise
    except SyntaxError as error:
        raise _Located(f"{file}:{error.lineno}: {error.msg}\n  {(error.text or '').strip()}") from None
    except (Exception, SystemExit) as error:  # a file that calls exit() must not look like a command that went well
        frames = [f for f in traceback.extract_tb(error.__traceback__) if Path(f.filename).name == file.name]
        where = f"{file}:{frames[-1].lineno}" if frames else f"{file}"
        code = f"\n  {frames[-1].line}" if frames and frames[-1].line else ""
        said = str(error.args[0]) if isinstance(error, KeyError) and error.args else str(error)
        hint = ""
        if isinstance(error, KeyError):
            hint = "\n  a column is missing: name it in `needs`, without its unit where that is a known one"
        raise _Located(f"{where}: {what} raised {type(error).__name__}: {said}{code}{hint}") from error


def _declared(effect: UserEffect) -> None:
    """Check what the class says of itself, and complete its title."""
    def bad(problem: str, remedy: str = "") -> EffectError:
        return EffectError(f"{effect.file}: {effect.kind.__name__}: {problem}" + (f"\n  {remedy}" if remedy else ""))

    name, declared, needs = effect.name, effect.parameters, effect.needs
    if not isinstance(name, str) or not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise bad(f"name is {name!r}", 'write e.g. name = "worm_gear": small letters, digits, _')
    if name in LIBRARY.names():
        raise bad(f"'{name}' is an effect of the library", "choose another name")
    if not isinstance(declared, (tuple, list)) or not declared:
        raise bad("parameters is missing or empty", 'write parameters = (EffectParameter("amplitude", "urad", 1e-4),)')
    seen = set()
    for p in declared:
        if not isinstance(p, EffectParameter):
            raise bad(f"parameter {p!r} is no EffectParameter", "EffectParameter(name, unit, usual size in SI)")
        try:
            units.factor(p.unit)
        except InputError as error:
            raise bad(f"parameter '{p.name}': {error.problem}", error.remedy) from None
        if p.name in seen:
            raise bad(f"parameter '{p.name}' is there twice")
        seen.add(p.name)
        if not (np.isfinite(p.prior) and p.prior > 0):
            raise bad(f"parameter '{p.name}': usual size {p.prior!r} is not positive")
        if not p.low <= 0 <= p.high:
            raise bad(f"parameter '{p.name}': zero, the nominal robot, is outside its range {p.low} … {p.high}")
    if isinstance(needs, str) or not all(isinstance(n, str) for n in needs):
        raise bad(f"needs is {needs!r}", 'write a tuple of column names, e.g. needs = ("humidity",)')
    type(effect).title = str(effect.title or name.replace("_", " "))


def _try(effect: UserEffect, robot: Robot) -> None:
    """Try the effect on poses of a robot: zero, shapes, derivative, pose by pose; note its channels and linearity."""
    at = trial(robot, effect.needs)
    priors = np.array([p.prior for p in effect.parameters])
    rng = np.random.default_rng(0)
    zero = effect.contribution(at, 0 * priors)
    for channel, value in zero.items():
        if np.abs(value).max() > 0:
            raise effect.error(
                f"theta = 0 adds something to {channel}", "at zero it must leave the nominal robot alone"
            )
    a, b = (priors * rng.standard_normal(len(priors)) for _ in range(2))
    whole = effect.contribution(at, a)
    if not whole.channels:
        raise effect.error("the contribution is empty", "return Contribution(actuator=…), rod=…, tool=… or another")
    given = effect.basis(at)
    for j, p in enumerate(effect.parameters):
        h = 1e-3 * p.prior * np.eye(len(priors))[j]
        slope = (effect.contribution(at, h) + effect.contribution(at, -h).scaled(-1.0)).scaled(0.5 / (1e-3 * p.prior))
        size = max((np.abs(change).max() for _, change in slope.items()), default=0.0)
        if not np.isfinite(size):
            raise effect.error(f"the derivative by '{p.name}' at zero is not finite")
        if size == 0:
            raise effect.error(
                f"'{p.name}' changes nothing at zero", "its derivative there must not vanish: a fit starts from zero"
            )
        if any(np.abs(given[j][c] - slope[c]).max() > 1e-4 * size for c in slope.channels):
            problem = f"basis is not the derivative of contribution by '{p.name}'"
            raise effect.error(problem, "without a basis of its own, differences are taken")
    for n in (0, len(at) - 1):
        one = effect.contribution(at.take(slice(n, n + 1)), a)
        for channel in whole.channels:
            y = whole[channel][n : n + 1]
            if channel not in one.channels or not np.allclose(one[channel], y, rtol=1e-9, atol=1e-12 * np.abs(y).max()):
                raise effect.error(
                    f"{channel} of a pose depends on which other poses stand beside it",
                    "each pose must be computed from its own row (no means, differences or sums over rows)",
                )
    type(effect).linear = _linear(effect, at, a, b)
    type(effect).channels = whole.channels


def _linear(effect: UserEffect, at: Situation, a: np.ndarray, b: np.ndarray) -> bool:
    summed = effect.contribution(at, a) + effect.contribution(at, b)
    joint = effect.contribution(at, a + b)
    return joint.channels == summed.channels and all(
        np.allclose(value, summed[c], rtol=1e-9, atol=1e-12 * (np.abs(value).max() + 1e-300))
        for c, value in joint.items()
    )


def trial(robot: Robot, needs: tuple[str, ...] = (), n: int = 9) -> Situation:
    """Some poses of a robot with tools, payloads and made-up values of every column, to try an effect on."""
    from pcalib.workspace import reachable

    rng = np.random.default_rng(7)
    found = reachable(robot, n, rng)
    columns = {f"temp_{part}": 20 + 6 * rng.standard_normal(n) for part in ("arms", "rods", "base")}
    columns |= {"temp": 20 + 6 * rng.standard_normal(n), "time": np.linspace(0.0, 7200.0, n)}
    columns |= {f"dir{i + 1}": rng.choice([-1.0, 1.0], n) for i in range(found.q.shape[1])}
    columns |= {name: rng.uniform(0.5, 2.0, n) for name in needs if name not in columns}
    tool = np.array([0.0, 0.0, -0.1]) + 0.05 * rng.standard_normal((n, 3))
    nominal = robot.mechanism.nominal
    return Situation.at(robot, nominal, found.q, found.pose, tool, rng.uniform(0.0, 2.0, n), columns)
