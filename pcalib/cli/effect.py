"""Effects: the library's list, and a template for one of your own.

pcalib effect list --json effects.json
pcalib effect new WormGear
pcalib effect check worm_gear.py:WormGear --robot models/delta.toml
"""

from __future__ import annotations

from pathlib import Path

from pcalib.cli.frame import JsonOption, say, show_table, write_json


def command(what: str, name: str = "", /, *, robot: Path | None = None, json: JsonOption = None) -> int | None:
    """Effects: the library's list, and a template for one of your own.

    'list' shows the library. 'new NAME' writes NAME.py, ten lines to change. 'check file.py:Class' loads it as a
    diagnosis would, tries it on poses of a robot, and says what it resembles.

    Args:
        what: list, new or check.
        name: Name of the new effect, or file.py:Class of the effect to check.
        robot: Robot file (TOML) to try it on.
    """
    from pcalib import effects, files, units
    from pcalib import robot as robots
    from pcalib.effects import user
    from pcalib.errors import EffectError, InputError, unknown

    described = robots.load(robot) if robot is not None else None
    if what == "list":
        found = []
        for each in effects.names():
            effect = effects.get(each)
            unsuited = effect.unsuited(described.mechanism) if described else ""
            about = {"title": effect.title, "variants": effect.variants, "wants": effect.wants, "unsuited": unsuited}
            found.append({"effect": each, **about})
        header = ("effect", "what happens", "variants", "seen best with", "note")
        show_table(header, [[c if isinstance(c, str) else ", ".join(c) for c in row.values()] for row in found])
        write_json(json, {"schema": "pcalib.effect/1", "effects": found})
        return None
    if what == "new":
        filename, classname, text = user.template(name)
        if Path(filename).exists():
            raise InputError("the file is there already", file=filename, remedy="choose another name, or move it away")
        files.write_text(filename, text)
        write_json(json, {"schema": "pcalib.effect/1", "file": filename, "class": classname})
        say(f"{filename} is written. Change it, then: pcalib effect check {filename}:{classname} --robot ROBOT.toml")
        return None
    if what != "check":
        raise EffectError(unknown("action", what, ("list", "new", "check")))
    if described is None:
        raise InputError(
            "--robot is needed: effects are tried on poses of a robot", remedy="e.g. --robot models/delta.toml"
        )
    effect = user.load(name, described)
    count = len(effect.parameters)
    say(
        f"{effect.name} loads, adds nothing at zero, and is {'' if effect.linear else 'not '}linear in its "
        f"{f'{count} parameters' if count > 1 else 'one parameter'} ({', '.join(effect.channels)})."
    )
    from pcalib.diagnosis.visibility import kinship

    lines = kinship(effect, described)
    for line in lines:
        say(f"- {line}")
    parameters = {p.name: {"unit": units.si(p.unit), "shown_in": p.unit} for p in effect.parameters}
    about = {"linear": effect.linear, "channels": effect.channels, "parameters": parameters, "kinship": lines}
    write_json(json, {"schema": "pcalib.effect/1", "effect": effect.name, **about})
    return None
