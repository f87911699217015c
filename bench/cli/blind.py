"""Write data sets with hidden faults whose truth lies sealed beside them.

    pcbench blind --seed 1 -n 20 -o blind
    pcalib fit blind/001.csv --robot blind/robot.toml -o blind/001.toml
    pcalib diagnose blind/001.csv --model blind/001.toml --json blind/001.diagnosis.json
    pcbench score blind
    pcbench blind --changed --seed 1 -n 20 -o pairs
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from pcalib.cli.frame import JsonOption, OutputFolder, SeedOption, WorkersOption, count


def command(
    *,
    output: OutputFolder,
    n: Annotated[int, Parameter(name="-n"), count(10_000)] = 20,
    seed: SeedOption = 0,
    robot: Path | None = None,
    changed: Annotated[bool, Parameter(negative=())] = False,
    workers: WorkersOption = 1,
    json: JsonOption = None,
) -> None:
    """Write data sets with hidden faults whose truth lies sealed beside them.

    Each is a robot with random geometric errors and, by chance, nothing else wrong, one physical effect, two, or
    something that no library lists. Sizes are set in units of noise, as far as they show once the geometry has been
    refitted. Poses, conditions and instrument differ: rich and plain plans, full poses and positions only, noise stated
    right and wrong. What is hidden where stands in the folder `sealed`, to be opened by `pcbench score`.

    Args:
        output: New folder for data, robot file and sealed truths.
        n: Number of data sets.
        seed: The same seed gives the same bytes.
        robot: Robot file; the default Delta where absent.
        changed: Write pairs of sessions instead, NNN.first.csv and NNN.csv; a part changed between them, or nothing.
        workers: Processes that share the work.
    """
    from bench.jobs import blind
    from pcalib import robot as robots
    from pcalib.cli import frame

    path = robot or Path(__file__).resolve().parents[2] / "models" / "delta.toml"
    if changed:
        from bench.jobs.changes import blind as pairs

        with frame.progress("changing parts", n) as advance:
            made = pairs.make(robots.load(path), output, n, seed, advance)
        frame.say(f"{output}: {len(made)} pairs of sessions, and robot.toml; what changed is sealed in {blind.SEALED}")
        content = {"schema": "pcbench.blind/1", "folder": output, "seed": seed, "sets": [one.name for one in made]}
        frame.write_json(json, {**content, "robot": "robot.toml", "sealed": blind.SEALED})
        first = made[0]
        model = first.with_suffix(".toml")
        frame.say(
            f"Ask each, e.g. pcalib fit {first.with_suffix('.first.csv')} --robot {output / 'robot.toml'} -o {model}; "
            f"pcalib changed {first} --model {model} --json {first.with_suffix('.changes.json')}; then pcbench score "
            f"{output}"
        )
        return
    with frame.progress("hiding faults", n) as advance:
        made = blind.make(robots.load(path), output, n, seed, workers, advance)
    frame.say(f"{output}: {len(made)} data sets, {made[0].name} to {made[-1].name}, and robot.toml")
    frame.say(f"{output / blind.SEALED}: what is hidden in them, sealed")
    content = {"schema": "pcbench.blind/1", "folder": output, "seed": seed, "sets": [path.name for path in made]}
    frame.write_json(json, {**content, "robot": "robot.toml", "sealed": blind.SEALED})
    first, model = made[0], made[0].with_suffix(".toml")
    frame.say(
        f"Diagnose each, e.g. pcalib fit {first} --robot {output / 'robot.toml'} -o {model}; "
        f"pcalib diagnose {first} --model {model} --json {first.with_suffix('.diagnosis.json')}; "
        f"then pcbench score {output}"
    )
