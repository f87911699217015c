"""The page in a real browser. Where a test is about the page alone, commands answer at once (`canned.py`)."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pcalib.workbench import session, worker


def begun(canned, look, **how):
    """A page on which the example has been fitted."""
    page = look(canned, **how)
    page.click("#example")
    page.wait_for_selector("#advice button:has-text('Add thermal_rods')")
    page.wait_for_selector("#work:empty", state="attached")
    return page


def test_a_person_walks_through_it(running, look):
    page = look(running)
    page.get_by_role("button", name="Try the example").press("Enter")  # by keyboard
    page.wait_for_selector("#cancel:not([hidden])", timeout=30_000)
    page.click("#cancel")
    page.wait_for_selector("#work:empty", state="attached", timeout=30_000)
    page.reload()
    page.get_by_role("button", name="Fit", exact=True).click()
    page.wait_for_selector("#advice button.main:has-text('Add thermal_rods')", timeout=120_000)
    page.click("#advice button.main")
    page.wait_for_selector("#history li:nth-child(2)", timeout=120_000)
    page.wait_for_selector("#verdict:has-text('Nothing is missing')", timeout=120_000)
    texts = page.locator("#history small").all_inner_texts()
    assert texts[0].startswith("55.7\xa0µm fit") and texts[2].startswith("22.3\xa0µm fit")
    targets = b"x_mm,y_mm,z_mm,temp_rods_degC\n0,0,-800,25\n150,-80,-850,25\n0,0,-500,25\n"
    page.set_input_files("#target-file", {"name": "targets.csv", "mimeType": "text/csv", "buffer": targets})
    with page.expect_download(timeout=60_000) as download:
        page.click("#downloads a[download='commands.csv']", timeout=60_000)
    rows = list(csv.DictReader(Path(download.value.path()).read_text().splitlines()[1:]))
    assert [row["status"] for row in rows] == ["ok", "ok", "outside_workspace"] and float(rows[1]["u95_um"]) > 0
    page.wait_for_selector("#commands:has-text('2 of 3 targets have a command')")
    page.set_input_files("#choose", {"name": "<b>.csv", "mimeType": "text/csv", "buffer": b"nonsense"})
    page.wait_for_selector("#problem:not([hidden]), #files:has-text('_b_.csv')", timeout=30_000)
    assert page.locator("b").count() == 0


def test_what_commands_say_is_text(canned, look):
    page = begun(canned, look)
    assert page.inner_text("#verdict") == "What is missing: <b>rods</b> grow."


def test_reload_in_mid_fit(canned, look):
    """The work goes on without the page, and the page shows it again."""
    hold = canned[1].folder / "hold"
    hold.touch()
    page = look(canned)
    page.click("#example")
    page.wait_for_selector("#work:has-text('4 more')")
    page.reload()
    page.wait_for_selector("#work:has-text('4 more')")
    assert page.locator("#cancel").is_visible() and page.inner_text("#files").startswith("data.csv · robot.toml")
    hold.unlink()
    page.wait_for_selector("#advice button:has-text('Add thermal_rods')")
    assert "55.7" in page.inner_text("#history")


def test_two_tabs_are_of_one_session(canned, look):
    """Each shows what the other does; a step is made once, whoever asks for it."""
    one, two = begun(canned, look), look(canned)
    two.wait_for_selector("#advice button:has-text('Add thermal_rods')")
    hold = canned[1].folder / "hold"
    hold.touch()
    one.click("#advice button.main")
    one.wait_for_selector("#work:has-text('Adding thermal_rods')")
    two.click("#advice button.main")
    two.wait_for_selector("#problem:has-text('a step is being made')")
    two.wait_for_selector("#work:has-text('Adding thermal_rods')")
    hold.unlink()
    for page in (one, two):
        page.wait_for_selector("#history li:nth-child(2)[aria-current], #history li:nth-child(2) [aria-current]")
    assert one.inner_text("#history") == two.inner_text("#history") and one.locator("#history li").count() == 2
    one.click("#history li:nth-child(1) button")
    two.wait_for_selector("#history li:nth-child(1) [aria-current]")


def test_ten_thousand_rows_are_taken_and_not_sent_back(canned, look):
    rows = "".join(f"{i * 1e-3:.3f},0,0,0,0,-800\n" for i in range(10_000))
    data = f"q1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm\n{rows}".encode()
    page = look(canned)
    sizes: list[int] = []
    page.on("response", lambda r: sizes.append(len(r.body())) if r.url.endswith("/state") else None)
    robot = {"name": "robot.toml", "mimeType": "text/plain", "buffer": b"[geometry]"}
    page.set_input_files("#choose", [{"name": "many.csv", "mimeType": "text/csv", "buffer": data}, robot])
    page.wait_for_selector("#advice button:has-text('Add thermal_rods')")
    assert (canned[1].folder / "many.csv").read_bytes() == data and max(sizes) < 20_000


ROWS = b"q1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm\n0,0,0,0,0,-800\n"


def test_rows_that_were_measured_later_are_joined_by_dropping_them(canned, look):
    page = look(canned)
    robot = {"name": "robot.toml", "mimeType": "text/plain", "buffer": b"[geometry]"}
    page.set_input_files("#choose", [{"name": "d.csv", "mimeType": "text/csv", "buffer": b"q1_deg\n"}, robot])
    page.wait_for_selector("#advice button:has-text('Add thermal_rods')")
    page.set_input_files("#choose", [{"name": "new.csv", "mimeType": "text/csv", "buffer": ROWS}])
    page.click("#question button:has-text('Join them')")
    page.wait_for_selector("#files:has-text('joined1.csv')")
    page.wait_for_selector("#cancel", state="hidden")
    assert (canned[1].folder / "new.csv").read_bytes() == ROWS and not page.is_visible("#question")
    assert "pcalib join d.csv new.csv -o joined1.csv" in session.load(canned[1].folder).shell()


def test_columns_with_unknown_names_are_named_in_the_page(canned, look):
    page = look(canned)
    (canned[1].folder / "refused").touch()
    robot = {"name": "robot.toml", "mimeType": "text/plain", "buffer": b"[geometry]"}
    page.set_input_files("#choose", [{"name": "d.csv", "mimeType": "text/csv", "buffer": b"J1,<i>X\n1,2\n"}, robot])
    page.click("#problem button:has-text('Name the columns')")
    page.fill("#question input[aria-label='Name of column J1']", "q1_deg")
    page.fill("#question input[aria-label='Name of column <i>X']", "x_mm")
    page.click("#question button:has-text('Read it so')")
    page.wait_for_selector("#advice button:has-text('Add thermal_rods')")
    assert (canned[1].folder / "d.csv").read_text().startswith("# columns = q1_deg,x_mm\nJ1,")
    assert page.locator("i").count() == 0 and not page.is_visible("#problem")


def test_a_law_is_read_before_it_runs(canned, look):
    page = begun(canned, look)
    page.evaluate("run('propose', {})")
    page.click("#advice button[aria-label='Add laws/tool_by_time.py:ToolByTime']")
    assert page.inner_text("#question pre").startswith("class ToolByTime: '<b>creeps</b>'")
    page.click("#question button:has-text('Run it')")
    page.wait_for_selector("#history li:nth-child(2):has-text('+ ToolByTime')")
    page.wait_for_selector("#work:empty", state="attached")
    said = session.load(canned[1].folder).shell()
    assert "pcalib add laws/tool_by_time.py:ToolByTime data.csv" in said
    assert "--model model2.toml --effect-file laws/tool_by_time.py:ToolByTime" in said
    (canned[1].folder / "laws" / "tool_by_time.py").write_text("import os")  # another program than the one agreed to
    page.click("#advice button:has-text('Show its code')")
    page.wait_for_selector("#question pre:has-text('import os')")


CUT_OFF = """[...document.querySelectorAll('button, td, th, small, h2, p, li')].filter(e =>
    e.scrollWidth > e.clientWidth + 1 && getComputedStyle(e).display !== 'inline').map(e => e.textContent)"""
CONTRASTS = """() => {
  const light = (rgb) => [0.2126, 0.7152, 0.0722].reduce((sum, share, i) => {
    const c = rgb[i] / 255;
    return sum + share * (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
  }, 0);
  const parts = (colour) => colour.match(/[0-9.]+/g).map(Number);
  const behind = (e) => {
    for (; e; e = e.parentElement) {
      const rgb = parts(getComputedStyle(e).backgroundColor);
      if (rgb.length === 3 || rgb[3] === 1) return rgb;
    }
    return [255, 255, 255];
  };
  return ['#files', '#history small', '#verdict', '.main', '#map p', '#candidates .yes', '#downloads a', 'h2'].map(
    (name) => {
      const e = document.querySelector(name), a = light(parts(getComputedStyle(e).color)), b = light(behind(e));
      return [name, (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05)];
    });
}"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_at_200_percent_and_in_dark(canned, look, scheme):
    """1280 × 720 at 200 % is 640 wide: nothing is cut off; text has the contrast of 4.5 that WCAG 2 asks for."""
    page = begun(canned, look, viewport={"width": 640, "height": 360}, device_scale_factor=2, color_scheme=scheme)
    assert page.evaluate("document.documentElement.scrollWidth") <= 640 and page.evaluate(CUT_OFF) == []
    assert {name: ratio for name, ratio in page.evaluate(CONTRASTS) if ratio < 4.5} == {}


def served(folder: Path) -> tuple[subprocess.Popen, str]:
    """`pcalib workbench` in a process of its own, and its address."""
    said = folder.with_suffix(".json")
    said.unlink(missing_ok=True)
    words = ["workbench", "--no-browser", "--folder", str(folder), "--json", str(said)]
    program = (sys.executable, str(Path(__file__).parent / "canned.py"))
    canned = f"from pcalib.workbench import worker; worker.PROGRAM = {program}"
    code = f"{canned}; from pcalib.cli import main; main({words})"
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.DEVNULL)
    while not said.exists():
        assert process.poll() is None
        time.sleep(0.02)
    return process, json.loads(said.read_text())["address"]


def test_a_killed_workbench_goes_on_where_it_was(browser, tmp_path):
    """What had been asked for is done by the next one in that folder, and the open page says what to do."""
    folder = tmp_path / "session"
    folder.mkdir()
    (folder / "hold").touch()
    process, address = served(folder)
    page = browser.new_page()
    page.goto(address)
    page.click("#example")
    page.wait_for_selector("#work:has-text('4 more')")
    process.kill()
    process.wait()
    page.wait_for_selector("#problem:has-text('Start it again with the same folder; nothing is lost.')")
    (folder / "hold").unlink()
    process, address = served(folder)
    page.goto(address)
    page.wait_for_selector("#advice button:has-text('Add thermal_rods')")
    page.wait_for_selector("#work:empty", state="attached")
    assert page.locator("#history li").count() == 1 and session.load(folder).pending == ()
    process.kill()
    process.wait()
    page.close()


def test_no_command_outlives_its_workbench(tmp_path):
    """A workbench is a command that never ends by itself; its standard input closes when its parent is killed."""
    words = ("workbench", "--no-browser", "--folder", str(tmp_path / "session"), "--json", str(tmp_path / "said.json"))
    process = subprocess.Popen([*worker.PROGRAM, *words], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)
    assert process.stdin is not None
    process.stdin.close()
    assert process.wait(60) == 1
