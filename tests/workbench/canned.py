"""Stands in for `pcalib` in tests of the page: writes at once what a command would, unless 'hold' is there.

It refuses data without a line of columns where 'refused' is there.
"""

import json
import sys
import time
from pathlib import Path

DATA = {"rms_pos_um": 55.7, "rms_rot_urad": 101.0, "level": "complete", "check": {"rms_pos_um": 58.1}}
FOUND = {
    "verdict": "established", "sentence": "What is missing: <b>rods</b> grow.",
    "next": [{"do": "add", "effect": "thermal_rods"}],
    "candidates": [{"spec": "thermal_rods", "s": 38.4, "p": 1e-4, "adequate": True, "note": None}],
    "heatmap": [{"channel": "actuator", "variable": "temp_rods", "p": 1e-4, "s": 38.5, "s_left": 3.1}],
}  # fmt: skip
WRITTEN = {
    "inspect": {"rows": 100, "fit": 80, "check": 20},
    "fit": DATA,
    "add": {"effect": "thermal_rods", "before": DATA, "after": DATA | {"rms_pos_um": 22.3}},
    "compare": {"heatmap": FOUND["heatmap"]},
    "diagnose": FOUND,
    "propose": {"laws": [{"spec": "laws/tool_by_time.py:ToolByTime", "words": "the tool creeps"}]},
}

words = sys.argv[1:]
while Path("hold").exists():
    time.sleep(0.01)
if Path("refused").exists() and "# columns" not in Path("d.csv").read_text():
    sys.exit("no column is called q1_deg")
if words[0] == "propose":
    Path("laws").mkdir(exist_ok=True)
    Path("laws/tool_by_time.py").write_text("class ToolByTime: '<b>creeps</b>'\n")
    words.remove("-o")
for option, content in (
    ("--json", json.dumps(WRITTEN.get(words[0], {}))), ("-o", "made = true\n"),
    ("--report", f"<title>{words[0]}</title><p>{words[0]} of this step"), ("--save", "RRF2"),
):  # fmt: skip
    if option in words:
        Path(words[words.index(option) + 1]).write_text(content)
print(" ".join(words))
