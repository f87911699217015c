"""Specs: what they say, and how they are refused."""

from __future__ import annotations

import json

import numpy as np
import pytest

from bench.cli import main
from bench.jobs.campaign import spec, sweep
from bench.jobs.campaign.study import Campaign
from bench.jobs.methods import BY_NAME
from bench.kinds import MODELS
from pcalib.errors import InputError

HEAD = 'name = "x"\nrobot = "delta"\n'


def test_defaults_make_a_campaign(written):
    campaign = spec.load(written(HEAD))
    cell = campaign.cell(0)
    assert campaign.n_trials == campaign.robots == 100 and campaign.n_cells == 1 and campaign.point(0) == {}
    assert [m.name for m in cell.methods] == ["classical", "model24", "paper", "complete"]
    assert cell.poses.kind == "random" and cell.poses.poses == 40
    assert np.allclose(cell.verify.tools, [[0, 0, 0], [0, 0, -0.1], [0, 0, -0.3]])
    assert not cell.geometry.sigma.any()


def test_units_of_any_kind_and_groups(written):
    text = """
    [geometry]
    sigma_length_um = 50
    sigma_angle_mrad = 1
    errors = { l11_mm = 0.3 }
    [[geometry.group]]
    parameters = ["l*", "b11.x"]
    sigma_length_mm = 0.01
    """
    cell = spec.load(written(HEAD + text)).cell(0)
    mechanism = cell.robot.mechanism
    sigma = dict(zip(mechanism.parameters, cell.geometry.sigma, strict=True))
    assert sigma["a11.y"] == pytest.approx(5e-5) and sigma["beta1.x"] == pytest.approx(1e-3)
    assert sigma["l32"] == sigma["b11.x"] == pytest.approx(1e-5)
    assert cell.geometry.common[mechanism.parameters.index("l11")] == pytest.approx(3e-4)


def test_the_distribution_has_the_stated_sigma(written):
    for kind in ("normal", "uniform"):
        text = f'[geometry]\ndistribution = "{kind}"\nsigma_length_mm = 0.1\n'
        geometry = spec.load(written(HEAD + text)).cell(0).geometry
        drawn = np.array([geometry.errors(0, np.random.default_rng(i)) for i in range(400)])
        lengths = drawn[:, geometry.sigma > 0]
        assert lengths.std() == pytest.approx(1e-4, rel=0.02) and abs(lengths.mean()) < 2e-6
        assert not drawn[:, geometry.sigma == 0].any()
        if kind == "uniform":
            assert np.abs(lengths).max() <= np.sqrt(3) * 1e-4


def test_listed_robots(written, tmp_path):
    (tmp_path / "errors.csv").write_text("l11_mm,p1.x_um\n0.1,5\n-0.2,0\n")
    text = HEAD + 'robots = 2\n[geometry]\ndistribution = "listed"\nfile = "errors.csv"\n'
    geometry = spec.load(written(text)).cell(0).geometry
    second = geometry.errors(1, np.random.default_rng(0))
    assert np.sort(second)[0] == pytest.approx(-2e-4) and np.count_nonzero(second) == 1
    with pytest.raises(InputError, match="robots = 3, but"):
        spec.load(written(text.replace("robots = 2", "robots = 3")))


def test_the_source_says_it_all(written, tmp_path):
    (tmp_path / "errors.csv").write_text("l11_mm\n0.1\n")
    header = "q1_deg,q2_deg,q3_deg,tool_x_mm,tool_y_mm,tool_z_mm"
    (tmp_path / "plan.csv").write_text(f"{header}\n0,0,0,0,0,-100\n5,0,0,0,0,-100\n")
    text = HEAD + 'robots = 1\n[geometry]\ndistribution = "listed"\nfile = "errors.csv"\n[plan]\nfile = "plan.csv"\n'
    campaign = spec.load(written(text))
    for name in ("errors.csv", "plan.csv", "spec.toml"):
        (tmp_path / name).unlink()
    again = spec.parse(campaign.source)
    listed = again.cell(0).poses.listed
    assert listed is not None and np.degrees(listed["q"][1][0]) == pytest.approx(5)
    assert listed["tool"][0][2] == pytest.approx(-0.1)
    assert again.source == campaign.source
    assert json.loads(campaign.source)["robot"]["kind"] == "delta"


def test_sweeps_cross_and_go_together(written):
    text = """
    [instrument]
    sigma_pos_um = 20
    [[sweep]]
    plan.poses = [12, 20, 40]
    [[sweep]]
    "geometry.sigma_length_mm" = [0.1, 0.5]
    "instrument.sigma_pos_mm" = [0.01, 0.1]
    [[sweep]]
    "method.paper.weighted" = [true, false]
    """
    campaign = spec.load(written(HEAD + text))
    assert campaign.n_cells == 12 and campaign.n_trials == 1200
    swept = ("plan.poses", "geometry.sigma_length_mm", "instrument.sigma_pos_mm", "method.paper.weighted")
    assert campaign.paths == swept
    last = campaign.cell(11)
    assert last.poses.poses == 40 and last.geometry.sigma.max() == pytest.approx(5e-4)
    assert last.instrument.values["sigma_pos"] == pytest.approx(1e-4)  # the base's 20 µm made way
    assert [m.weighted for m in last.methods] == [True, True, False, True]
    assert [m.weighted for m in campaign.cell(10).methods] == [True] * 4


def test_robots_can_be_swept(written):
    campaign = spec.load(written('name = "x"\n[[sweep]]\nrobot = ["delta", "delta_small"]\n'))
    assert [campaign.cell(i).robot.name for i in (0, 1)] == ["delta", "delta_small"]


def test_parts_do_not_depend_on_anything_but_the_spec(written):
    campaign = Campaign(spec.load(written(robots="robots = 5")))
    assert [list(campaign.part(number)) for number in range(campaign.n_parts)] == [[0, 1], [2, 3], [4]]


def test_millions_of_combinations_are_read_at_once_and_not_begun_unasked(written, tmp_path, capsys):
    axes = ("plan.poses", "plan.candidates", "verify.targets", "output.part_robots")[:3]
    text = "".join(f'[[sweep]]\n"{path}" = {list(range(20, 168))}\n' for path in axes)
    path = written(written.small + text)
    campaign = spec.load(path)
    assert campaign.n_cells == 148**3 and campaign.n_trials == 6 * 148**3
    assert campaign.point(149) == {"plan.poses": 20, "plan.candidates": 21, "verify.targets": 21}
    assert main(["campaign", str(path), "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "3,241,792 combinations × 6 robots = 19,450,752 robots: about " in said and "--yes" in said
    assert not (tmp_path / "out").exists()


REFUSED = {
    "unknown key": ("robts = 3", "unknown key 'robts' .*did you mean 'robots'"),
    "unknown key in a table": ("[plan]\npses = 3", r"\[plan\] unknown key 'pses' .*did you mean 'poses'.*accepted"),
    "unknown key in a method": (
        '[[method]]\nname = "paper"\nlevl = "x"',
        r"\[method\[1\]\] unknown key 'levl'.*effects",
    ),
    "negative σ": (
        "[geometry]\nsigma_length_mm = -0.1",
        r"\[geometry\] 'sigma_length_mm' must be from 0 to 50, not -0.1",
    ),
    "negative noise": ("[instrument]\nsigma_pos_mm = -1", r"\[instrument\] 'sigma_pos_mm' must be"),
    "no unit": ("[geometry]\nsigma_length = 0.1", r"\[geometry\] key 'sigma_length' has no unit.*\n.*sigma_length_mm"),
    "wrong unit": ("[geometry]\nsigma_length_deg = 0.1", r"'deg' is not a unit of length"),
    "unknown effect": (
        '[[method]]\nname = "paper"\neffects = ["drive_complaince"]',
        r"\[method\[1\]\] effects: unknown effect 'drive_complaince'.*did you mean 'drive_compliance'",
    ),
    "unknown fault": (
        "[faults.backslash]\ngap_um = 3",
        r"\[faults\] unknown fault 'backslash'.*did you mean 'backlash'",
    ),
    "fault of another kind of robot": (
        "[faults.encoder_eccentricity]\namplitude_urad = { normal = [0, 50] }",
        r"\[faults.encoder_eccentricity\] .*rotary drives.*\n.*faults of a linear_delta: .*backlash",
    ),
    "fault of a part that the robot has not": (
        "[faults.arm_bending]\nvertical_um_N = 0.2",
        r"\[faults.arm_bending\] .*\n.*faults of a planar: .*base_drift",
    ),
    "fault without its column": (
        "[faults.thermal_arms]\nexpansion_ppm_K = { normal = [0, 20] }",
        r"\[faults.thermal_arms\] needs columns that \[plan\] kind = \"random\" does not bring: temp_arms\n"
        r'.*kind = "rich", or file = ',
    ),
    "effect without its columns": (
        '[plan]\nkind = "border"\n[[method]]\nname = "paper"\n[[method]]\nname = "complete"\n'
        'effects = ["friction_hysteresis"]',
        r"\[method\[2\]\] effects: friction_hysteresis needs columns .*\"border\" does not bring: dir1, dir2, dir3",
    ),
    "sweep to a plan without a column": (
        '[faults.base_drift]\nv_um_h = [1, 0, 0]\n[[sweep]]\n"plan.kind" = ["rich", "d-optimal"]',
        r"plan.kind = \"d-optimal\" is impossible: \[faults.base_drift\] needs .*: time",
    ),
    "unknown level": (
        '[[method]]\nname = "mine"\nlevel = "model25"',
        r"level: unknown level 'model25'.*model24.*complete",
    ),
    "method without level": ('[[method]]\nname = "mine"', r"'level' is missing.*classical, model24, paper, complete"),
    "method twice": (
        '[[method]]\nname = "paper"\n[[method]]\nname = "paper"',
        r"\[method\[2\]\] name: 'paper' is taken",
    ),
    "unknown plan": ('[plan]\nkind = "spiral"', r"\[plan\] 'kind' must be one of \"random\", \"border\""),
    "no poses": ("[plan]\nposes = 0", r"\[plan\] 'poses' must be"),
    "half a pose": ("[plan]\nposes = 1.5", r"\[plan\] 'poses' must be a whole number"),
    "unknown robot": ("", "unknown robot 'dleta'.*did you mean 'delta'"),
    "unknown parameter": ("[geometry.errors]\nl99_mm = 1", "unknown parameter 'l99'"),
    "pattern of nothing": (
        '[[geometry.group]]\nparameters = ["z*"]',
        r"\[geometry.group\[1\]\] parameters: 'z\*' is none",
    ),
    "tools of one number": ("[verify]\ntools_mm = 300", r"\[verify\] 'tools_mm' must be a list of lengths"),
    "tool twice": ("[verify]\ntools_mm = [100, 100]", "names a tool twice"),
    "impossible distribution": ("[faults.backlash]\ngap_urad = { normal = [1, -1] }", "σ is negative"),
    "unknown distribution": (
        "[faults.backlash]\ngap_urad = { gauss = [1, 1] }",
        "unknown distribution 'gauss'.*normal",
    ),
    "listed without file": ('[geometry]\ndistribution = "listed"', "go together"),
    "robots in the spec": ("[geometry]\nrobots = []", "robots are listed in a file"),
    "absent file": ('[plan]\nfile = "no.csv"', r"\[plan\] file 'no.csv' does not exist"),
    "not TOML": ("[plan", "not valid TOML"),
    "a date": ("seed = 2006-05-15", "must be|no dates or times"),
    # sweeps
    "sweep of nothing": ("[[sweep]]", r"\[sweep\[1\]\] is empty"),
    "sweep of no list": ('[[sweep]]\n"plan.poses" = 3', r"\[sweep\[1\]\] 'plan.poses' must be a list of values"),
    "sweep of unequal lists": ('[[sweep]]\n"plan.poses" = [20, 40]\n"plan.candidates" = [100]', "need the same length"),
    "sweep of an unknown section": (
        '[[sweep]]\n"plans.poses" = [20]',
        "unknown section to sweep 'plans'.*did you mean 'plan'",
    ),
    "sweep of an unknown key": (
        '[[sweep]]\n"plan.pses" = [20, 30]',
        r"plan.pses = 20 is impossible: \[plan\] unknown key",
    ),
    "sweep of an unknown method": ('[[sweep]]\n"method.mine.level" = ["complete"]', "unknown item 'mine'.*classical"),
    "sweep twice": ('[[sweep]]\n"plan.poses" = [20]\n[[sweep]]\n"plan.poses" = [30]', "is swept twice"),
    "sweep twice in other units": (
        '[[sweep]]\n"instrument.sigma_pos_mm" = [1]\n[[sweep]]\n"instrument.sigma_pos_um" = [9]',
        "twice",
    ),
    "sweep to a bad value": (
        '[[sweep]]\n"plan.poses" = [20, -3]',
        r"\[sweep\[1\]\] plan.poses = -3 is impossible: \[plan\] 'poses'",
    ),
    "sweep over one name": (
        '[[sweep]]\nrobot = ["a.toml", "b.toml"]',
        r"\[sweep\[1\]\]: two steps are called 'robot = delta'.*names of their own",
    ),
    "sweep over numbers that tables cannot tell apart": (
        '[[sweep]]\n"instrument.sigma_pos_mm" = [0.1, 0.10000001]',
        r"two steps are called 'instrument.sigma_pos_mm = 0.1'.*first six digits",
    ),
    "sweep of the seed": ('[[sweep]]\n"seed" = [1, 2]', "unknown section to sweep 'seed'"),
    "sweep into a value": ('[[sweep]]\n"plan.poses.more" = [1]', "leads nowhere|must be"),
    "sweep that is a table": ("[sweep]\nplan = 3", r"written as \[\[sweep\]\]"),
}  # fmt: skip


ROBOTS = {
    "unknown robot": "dleta",
    "fault of another kind of robot": "linear_delta",
    "fault of a part that the robot has not": "planar",
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_run_is_refused_with_its_key(written, case):
    text, message = REFUSED[case]
    head = HEAD.replace("delta", ROBOTS.get(case, "delta"))
    for name in ("a.toml", "b.toml") if case == "sweep over one name" else ():
        (written.folder / name).write_text((MODELS / "delta.toml").read_text())
    base = "[plan]\nposes = 20\n" if case == "sweep into a value" else ""
    path = written(head + base + text)
    with pytest.raises(InputError, match="(?s)" + message) as refused:
        spec.load(path)
    assert "spec.toml" in str(refused.value) or case == "absent file"


def test_the_line_is_told(written):
    with pytest.raises(InputError, match=r"spec.toml:4: "):
        spec.load(written(HEAD + "[plan]\npses = 3\n"))


def test_a_fault_of_the_spec_is_not_blamed_on_a_sweep(written):
    text = HEAD + '[instrument]\nkind = "eye"\n[[sweep]]\n"plan.poses" = [20, 30]\n'
    with pytest.raises(InputError) as refused:
        spec.load(written(text))
    assert "sweep" not in str(refused.value) and "[instrument]" in str(refused.value)


def test_sweeps_leave_the_spec_as_it_is():
    table = {"plan": {"poses": 3}, "method": [{"name": "a", "level": "x"}]}
    changed = sweep.applied(table, {"plan.poses": 4, "method.a.level": "y"})
    assert changed == {"plan": {"poses": 4}, "method": [{"name": "a", "level": "y"}]}
    assert table == {"plan": {"poses": 3}, "method": [{"name": "a", "level": "x"}]}


def test_every_preset_is_a_method_of_the_delta(written):
    text = "".join(f'[[method]]\nname = "{name}"\n' for name in BY_NAME)
    assert len(spec.load(written(HEAD + text)).cell(0).methods) == len(BY_NAME)


def test_a_file_elsewhere_that_a_spec_names_is_not_told(tmp_path):
    """A spec from somebody else must not bring what stands in other files into a message."""
    (tmp_path / "secret.toml").write_text('password = "tell nobody"\n')
    (tmp_path / "secret.csv").write_text("password,tell\nnobody,this\n")
    folder = tmp_path / "specs"
    folder.mkdir()
    for text in ('robot = "../secret.toml"', 'robot = "delta"\n[plan]\nfile = "../secret.csv"',
                 'robot = "delta"\n[geometry]\nfile = "../secret.csv"', 'robot = "/etc/passwd"'):  # fmt: skip
        (folder / "spec.toml").write_text(f'name = "x"\n{text}\n')
        with pytest.raises(InputError, match="names a file that cannot be used") as caught:
            spec.load(folder / "spec.toml")
        assert not any(word in str(caught.value) for word in ("password", "nobody", "root:"))
