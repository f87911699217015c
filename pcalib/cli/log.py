"""Every step that led to a model, and the way back to any of them.

pcalib log m.toml
pcalib log m.toml --back-to 1 -o m1.toml
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from pcalib.cli._inputs import EffectFiles
from pcalib.cli.frame import JsonOption, RewriteOption, say, show_table, write_json


def command(
    model: Path,
    /,
    *,
    back_to: int | None = None,
    output: RewriteOption = None,
    effect_file: EffectFiles = (),
    json: JsonOption = None,
) -> int | None:
    """Every step that led to a model, and the way back to any of them.

    Args:
        model: Model file.
        back_to: Number of a step: write the model as it was after it. The later steps stay in the log.
        output: Model file to write with --back-to; the same file when absent.
    """
    from pcalib import modelfile
    from pcalib.errors import InputError

    calibrated = modelfile.load(model, effect_file)
    history = calibrated.history
    rows = [
        {
            "step": i + 1,
            "action": str(entry.get("action", "")),
            "effect": str(entry.get("effect", "")),
            "level": str(entry.get("level", "")),
            "effects": [str(e.get("spec", "")) for e in entry.get("effects", [])],
            "data": str(entry.get("data", "")),
            "rms_pos_um": entry.get("rms_pos_um"),
            "chi2_dof": entry.get("chi2_dof"),
            "check_rms_pos_um": (entry.get("check") or {}).get("rms_pos_um"),
        }
        for i, entry in enumerate(history)
    ]
    if back_to is None and output is not None:
        raise InputError("-o is for the model of a step", file=output, remedy="name the step with --back-to")
    if back_to is not None and not 1 <= back_to <= len(history):
        raise InputError(
            f"--back-to {back_to}: the model has steps 1 to {len(history)}", file=model,
            remedy=f"'pcalib log {model}' lists them",
        )  # fmt: skip
    write_json(json, {"schema": "pcalib.log/1", "model": model, "steps": rows})
    if back_to is None:
        say(f"{len(rows)} step{'s' * (len(rows) != 1)} led to {model}.")
        show_table(
            ("step", "what", "level", "effects", "data", "RMS", "held out", "χ²/dof"),
            [
                (
                    r["step"], f"{r['action']} {r['effect']}".strip(), r["level"], ", ".join(r["effects"]) or "–",
                    r["data"], _size(r["rms_pos_um"]), _size(r["check_rms_pos_um"]), _n(r["chi2_dof"], 2),
                )
                for r in rows
            ],
        )  # fmt: skip
        return None
    restored = modelfile.restore(calibrated, history[back_to - 1], effect_file)
    entry = modelfile.snapshot(restored, "back", effect=f"to step {back_to}")
    target = output or model
    modelfile.save(target, replace(restored, history=(*history, entry)))
    say(f"The model as it was after step {back_to} is written to {target}.")
    return None


def _size(um) -> str:
    from pcalib.wording import size

    return size(um * 1e-6) if um is not None else "–"


def _n(value, digits: int) -> str:
    return f"{value:.{digits}f}" if value is not None else "–"
