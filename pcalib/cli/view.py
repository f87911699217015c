"""Open the viewer on a recording, or on a model and what it says of the robot.

    pcalib view out/demo
    pcalib view out/demo/demo.rrd --browser
    pcalib view m.toml --tool 0,0,0mm --tool 0,0,-300mm
    pcalib view m.toml --follow
    pcalib view m.toml --save m.rrd --json m.view.json
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np

from pcalib.cli._inputs import EffectFiles
from pcalib.cli._tools import ToolsOption, tool_options
from pcalib.cli.frame import BesideOption, JsonOption, quantity


def command(
    run: Path,
    /,
    *,
    tool: ToolsOption = (),
    payload: Annotated[np.ndarray | None, quantity("mass")] = None,
    save: BesideOption = None,
    browser: bool = False,
    follow: bool = False,
    effect_file: EffectFiles = (),
    json: JsonOption = None,
) -> int | None:
    """Open the viewer on a recording, or on a model and what it says of the robot.

    A model is shown as the robot it describes, with what the TCP would miss by if commands came from the drawing, all
    over the workspace, as the model predicts it. Step along the timeline 'model' to compare the drawing, the steps that
    led to the model, and the model itself.

    Args:
        run: Model file (.toml), recording (.rrd), or a folder with one recording, such as a demo writes.
        tool: TCP in the plate frame, e.g. 0,0,-300mm; may be given several times. For model files.
        payload: Mass at the TCP, e.g. 1kg. For model files.
        save: Write the recording to this file, and open no viewer.
        browser: Show it in the browser instead of a window.
        follow: Keep the window open, and show every step that is made of the model file from now on.
    """
    import shutil
    import tempfile

    from pcalib import files, ladder, modelfile, view
    from pcalib.cli import frame
    from pcalib.errors import InputError
    from pcalib.model import Model
    from pcalib.uncertainty.maps import with_expected
    from pcalib.view import following, viewer
    from pcalib.view.model import predicted

    if run.suffix != ".toml":
        if tool or payload is not None or follow:
            raise InputError("--tool, --payload and --follow are for model files; a recording has its own", file=run)
        found = viewer.recording_of(run)
        frame.write_json(json, {"schema": "pcalib.view/1", "run": run, "recording": save or found})
        if save is None:
            viewer.show(found, browser)
            return None
        with files.atomic(save) as temporary:
            shutil.copyfile(found, temporary)
        frame.say(f"Recording copied to {save}.")
        return None

    model = modelfile.load(run, effect_file)
    tools = tool_options(tool, model.robot)
    load = 0.0 if payload is None else float(payload[0])
    if load < 0:
        raise InputError("--payload: a payload cannot be negative", remedy="write e.g. 2kg")

    def drawn(now: Model) -> ladder.Ladder:
        return with_expected(predicted(now, tools, load, effect_file), load, effect_file)

    if follow:
        if save is not None or browser:
            raise InputError("--follow is for a window", remedy="leave --save and --browser out")
        following.follow(run, viewer.Live(), drawn, effect_file)
        return None
    what = drawn(model)
    content = {"schema": "pcalib.view/1", "run": run, "recording": save, "source": what.source, "payload_kg": load}
    frame.write_json(json, content | ladder.as_json(what))
    if save is not None:
        view.write(save, what, model=model, identity=run.stem)
        frame.say(f"Recording written to {save}.")
        return None
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / f"{run.stem}.rrd"
        view.write(recording, what, model=model, identity=run.stem)
        viewer.show(recording, browser)
    return None
