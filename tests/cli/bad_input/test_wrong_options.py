"""Options that cannot be meant."""

from __future__ import annotations

import pytest

OPTIONS = {
    "pcalib fit data.csv --robot robot.toml -o new.toml --json new.json": {
        "--level competle": "unknown level 'competle' .did you mean 'complete'",
        "--method magic": "unknown method 'magic'; accepted",
        "--loss l2": "unknown loss 'l2'; accepted",
        "--fix l99": "unknown parameter of level complete 'l99'",
        "--bound l11": "write NAME=LOW,HIGHunit",
        "--bound l11=-1,1": "no unit",
        "--bound l11=1,-1mm": "low before high",
        "--bound l11=-1,1deg": "unknown unit 'deg'",
        "--level nominal --bound l11=-1,1mm": "unknown parameter of level nominal 'l11'; accepted: none",
        "--bound l99=-1,1mm": "unknown parameter of level complete 'l99'",
        "--length-tolerance 0.1": "no unit\n.*e.g. 0.1mm",
        "--length-tolerance 0mm": "must be more than 0",
        "--length-tolerance 1deg": "unknown unit 'deg'",
        "--folds 1": "choose 2 to",
        "--folds 999": "choose 2 to",
        "--effect gremlins": "unknown effect 'gremlins'",
        "--effect drive_compliance:leg": "no variant 'leg'",
        "--effect gear_ripple@0": "not a list of cycles",
        "--effect backlash --effect backlash:arm": "given twice",
        "--effect mine.py": "write file.py:ClassName",
        "--colour red": "--colour",
    },
    "pcalib add {} data.csv --model m.toml -o new.toml": {
        "gremlins": "unknown effect or level 'gremlins'; accepted",
        "backlash+gear_ratio": "unknown effect or level",
        "complete": "is of level complete already",
        "model24": "no extension of the model's level complete",
        "thermal_arms": "needs columns that the data do not have: temp_arms",
    },
    "pcalib add {} data.csv --model soft.toml -o new.toml": {"drive_compliance": "in the model already"},
    "pcalib drop {} data.csv --model soft.toml -o new.toml": {"backlash": "unknown effect of the model 'backlash'"},
    "pcalib explain {} data.csv --model m.toml --json new.json": {
        "gremlins": "unknown effect or level 'gremlins'; accepted",
        "complete": "is of level complete already",
        "tool_bending": "cannot be judged on these data",
    },
    "pcalib explain {} data.csv --model soft.toml": {"drive_compliance": "is in the model already"},
    "pcalib next data.csv --model m.toml -o new.csv --between": {
        "backlash": "name two explanations",
        "backlash,backlash": "two different explanations",
        "backlash,gremlins": "unknown effect or level 'gremlins'",
        "backlash,nothing -n 0": "make no plan\n.*at least 1",
        "backlash,nothing -n 100000": "make no plan\n.*at least 1",
        "backlash,nothing --payload 2": "no unit\n.*e.g. 2kg",
        "backlash,nothing --payload -2kg": "cannot be negative",
        "backlash,nothing --tool 0,0mm": "needs 3 numbers",
        "backlash,nothing --tool 0,0,-90m": "longer than the robot",
        "backlash,nothing --seed -1": "seed",
    },
    "pcalib compensate targets.csv --model m.toml -o new.csv": {
        "--tool 0,0,-300": "no unit\n.*e.g. 0,0,-300mm",
        "--tool 0,0,-90m": "longer than the robot",
        "--method magic": "unknown method 'magic'; accepted",
    },
    "pcalib diagnose data.csv --model m.toml --json new.json": {
        "--most 9": "not searched\n.*1, 2 or 3",
        "--seed -1": "seed",
    },
    "pcalib plan --robot robot.toml -o new.csv": {
        "-n 0": "Must be >= 1",
        "-n many": "unable to convert",
        "--level competle": "did you mean 'complete'",
        "--sigma-pos 0mm": "must be more than 0",
        "--seed -1": "seed",
        "--tool 0,0,-90m": "longer than the robot",
    },
    "pcalib log m.toml -o new.toml": {
        "--back-to 9 --json new.json": "has steps 1 to 1",
        "--back-to 0": "has steps 1 to 1",
        "": "name the step with --back-to",
    },
    "pcalib view m.toml --save new.rrd": {"--payload -1kg": "cannot be negative", "--tool 1,2mm": "needs 3 numbers"},
    "pcalib effect": {
        "new 1x": "cannot name an effect",
        "news X": "unknown action 'news'",
        "check mine.py:Mine": "--robot",
    },
    "pcalib import carriage-steps spec.toml -o new.csv --robot-output new.toml": {
        "--set rod": "has no value",
        "--set rods=1mm": "did you mean 'rod'",
    },
    "pcalib firmware printer.toml": {"--dialect marlin": "unknown dialect 'marlin'", "-o new.cfg": "say --dialect"},
    "pcbench simulate truth.toml -o new.csv": {
        "-n 0": "Must be >= 1",
        "--plan magic": "unknown plan 'magic'; accepted",
        "--payload -1kg": "cannot be negative",
        "--workers 0": "--workers. Must be >= 1",
        "--seed -1": "--seed",
    },
    "pcbench verify m.toml truth.toml": {
        "--cycles 0": "--cycles. Must be >= 1",
        "--method magic": "unknown method 'magic'",
        "--payload -1kg": "cannot be negative",
        "--temperature -400degC": "nothing below",
        "--tool 0,0,-90m": "longer than the robot",
    },
    "pcbench blind -o new": {"-n 0": "Must be >= 1", "--robot printer.toml": "unknown key"},
}  # fmt: skip


@pytest.mark.parametrize("command", OPTIONS)
def test_wrong_options(command, refused):
    for option, said in OPTIONS[command].items():
        argv = command.replace("{}", option) if "{}" in command else f"{command} {option}"
        refused(argv, said)
