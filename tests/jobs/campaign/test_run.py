"""Running campaigns: the same bytes however often they are killed, and whoever does the work."""

from __future__ import annotations

import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from bench import pool
from bench.cli import main
from bench.jobs import running, store, study
from bench.jobs.campaign import spec, trial
from bench.jobs.campaign.study import Campaign
from pcalib.errors import InputError

ROOT = Path(__file__).parents[3]
WAIT = 300
"""[s] after which a program hangs; a busy machine may take a hundred times as long as an idle one."""
COMMAND = [sys.executable, "-c", "import sys; from bench.cli import main; sys.exit(main())", "campaign"]


def digest(folder: Path) -> str:
    return hashlib.sha256((folder / "results.parquet").read_bytes()).hexdigest()


def begun(spec_file: Path, folder: Path, *options: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [*COMMAND, str(spec_file), "-o", str(folder), "--no-figures", *options],
        cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True,
    )  # fmt: skip


@pytest.fixture
def reference(written, tmp_path) -> tuple[spec.Spec, str]:
    """The small campaign and the digest of its results, done in this process."""
    campaign = spec.load(written())
    running.run(Campaign(campaign), tmp_path / "reference", 1)
    return campaign, digest(tmp_path / "reference")


def test_what_a_campaign_leaves(reference, tmp_path):
    campaign, _ = reference
    folder = tmp_path / "reference"
    assert sorted(p.name for p in folder.iterdir()) == [".lock", "campaign.json", "results.parquet"]
    table = pq.read_table(folder / "results.parquet")
    assert len(table) == 6 * 2 * 2
    assert table["robot"].to_pylist() == sorted(table["robot"].to_pylist())
    about = json.loads(table.schema.metadata[Campaign.SCHEMA[:16].encode()])
    assert about["seed"] == 11 and about["spec"] == json.loads(campaign.source)
    assert {"numpy", "mujoco", "pcalib", "python"} <= set(about["versions"])
    kept = [errors is not None for errors in table["error_um"].to_pylist()]
    assert kept == [robot < 1 for robot in table["robot"].to_pylist()]  # map_robots = 1


@pytest.mark.parametrize("n_workers", [1, 2])
def test_any_number_of_workers(reference, tmp_path, n_workers):
    campaign, expected = reference
    done: list[int] = []
    outcome = running.run(Campaign(campaign), tmp_path / "pool", n_workers, progress=done.append)
    assert digest(tmp_path / "pool") == expected
    assert outcome.trials == sum(done) == 6 and outcome.rate > 0


def finished(parts: Path) -> list[str]:
    """Names of the parts on disk; empty before the folder is made and after the campaign has removed it."""
    try:
        return [name for name in os.listdir(parts) if name.endswith(".parquet") and not name.startswith(".")]
    except FileNotFoundError:
        return []


def test_killed_at_random_moments(written, tmp_path):
    """SIGKILL, workers included or left behind, again and again; what was finished stays, and the end is the same."""
    spec_file = written(robots="robots = 24", part_robots="part_robots = 1")
    running.run(Campaign(spec.load(spec_file)), tmp_path / "whole", 1)
    folder, rng, kills = tmp_path / "killed", random.Random(7), 0
    parts = folder / "parts"
    for attempt in range(20):
        process = begun(spec_file, folder, "--workers", "2" if attempt == 1 else "1")
        had = len(finished(parts))
        enough = had + rng.randint(1, 5) if kills < 3 else 99
        while process.poll() is None:
            if len(finished(parts)) >= enough:
                time.sleep(rng.random() * 0.03)
                (os.kill if attempt == 1 else os.killpg)(process.pid, signal.SIGKILL)  # workers left behind, or not
                break
            time.sleep(0.002)
        process.communicate(timeout=WAIT)
        if process.returncode == 0:
            break
        assert process.returncode == -signal.SIGKILL
        kills += 1
        assert len(finished(parts)) >= had
        with (parts / ".000099.parquet.litter.parquet").open("wb") as litter:  # of a write that was cut short
            litter.write(b"PAR1")
    assert kills >= 3
    assert digest(folder) == digest(tmp_path / "whole")
    assert sorted(p.name for p in folder.iterdir()) == [".lock", "campaign.json", "results.parquet", "summary.csv"]


def broken_off(campaign: spec.Spec, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A campaign killed just before its end; the folder of its parts."""
    with monkeypatch.context() as patch:
        patch.setattr(store.Store, "finish", lambda self: [])
        running.run(Campaign(campaign), folder, 1)
    return folder / "parts"


def test_a_part_cut_short_is_done_anew(reference, tmp_path, monkeypatch):
    campaign, expected = reference
    parts, done = broken_off(campaign, tmp_path / "cut", monkeypatch), []
    _, second, third = sorted(parts.iterdir())
    second.write_bytes(second.read_bytes()[:-100])
    third.write_bytes(b"")
    running.run(Campaign(campaign), tmp_path / "cut", 1, progress=done.append)
    assert done == [2, 2, 2] and digest(tmp_path / "cut") == expected  # one part was there, two are done


def test_a_damaged_part_is_named_set_aside_and_done_anew(reference, tmp_path, monkeypatch):
    """With its beginning and its end whole, so that only reading all of it tells."""
    campaign, expected = reference
    parts, said, done = broken_off(campaign, tmp_path / "hurt", monkeypatch), [], []
    hurt = sorted(parts.iterdir())[1]
    whole = hurt.read_bytes()
    hurt.write_bytes(whole[:4] + bytes(len(whole) // 2) + whole[4 + len(whole) // 2 :])
    running.run(Campaign(campaign), tmp_path / "hurt", 1, progress=done.append, say=said.append)
    assert done == [6, -2, 2] and digest(tmp_path / "hurt") == expected
    assert len(said) == 1 and str(hurt) in said[0] and "its trials are done again" in said[0]
    assert (tmp_path / "hurt" / "damaged" / hurt.name).exists() and not parts.exists()


def test_parts_of_another_study_are_not_taken(reference, tmp_path, monkeypatch, written):
    campaign, expected = reference
    parts = broken_off(campaign, tmp_path / "mixed", monkeypatch)
    other = spec.load(written(poses="poses = 20"))
    (first, *_) = sorted(parts.iterdir())
    trials = range(0, 2)
    first.write_bytes(study.encode(Campaign(other), trials, study.rows(Campaign(other), trials)))
    running.run(Campaign(campaign), tmp_path / "mixed", 1)
    assert digest(tmp_path / "mixed") == expected


def test_damaged_results_are_set_aside_and_done_anew(reference, tmp_path):
    campaign, expected = reference
    results, said = tmp_path / "reference" / "results.parquet", []
    whole = results.read_bytes()
    results.write_bytes(whole[:4] + bytes(len(whole) // 2) + whole[4 + len(whole) // 2 :])
    assert running.run(Campaign(campaign), tmp_path / "reference", 1, say=said.append).trials == 6
    assert len(said) == 1 and str(results) in said[0] and digest(tmp_path / "reference") == expected


def test_a_long_campaign_resumes_at_once(written, tmp_path):
    """A million robots in 100,000 parts: one look at each file, and no part of it is built or read."""
    campaign = Campaign(spec.load(written(robots="robots = 1000000", part_robots="part_robots = 10")))
    with store.opened(campaign, tmp_path / "long") as kept:
        kept.parts.mkdir()
        for number in range(0, campaign.n_parts, 100):
            kept.part(campaign.part(number)).write_bytes(store.MAGIC + store.MAGIC)
        calls = []
        campaign.columns = lambda: calls.append(1)
        assert len(kept.missing()) == 99_000 and kept.kept() == 10_000 and not calls


def test_a_finished_campaign_is_not_done_again(reference, tmp_path, capsys, written, monkeypatch):
    campaign, expected = reference
    monkeypatch.setattr(study, "perform", None)
    assert running.run(Campaign(campaign), tmp_path / "reference", 1).trials == 0
    assert main(["campaign", str(written()), "-o", str(tmp_path / "reference"), "--no-figures"]) == 0
    assert "all robots were done before" in capsys.readouterr().out
    assert digest(tmp_path / "reference") == expected


def test_results_cut_short_are_made_anew_from_the_parts(reference, tmp_path, monkeypatch):
    campaign, expected = reference
    broken_off(campaign, tmp_path / "merge", monkeypatch)
    (tmp_path / "merge" / "results.parquet").write_bytes(b"PAR1 and no more")
    running.run(Campaign(campaign), tmp_path / "merge", 1)
    assert digest(tmp_path / "merge") == expected


def test_what_a_kill_leaves_while_results_are_made_goes(reference, tmp_path):
    campaign, expected = reference
    folder = tmp_path / "reference"
    for name in (".results.parquet.a1b2.parquet", ".campaign.json.c3d4.json"):
        (folder / name).write_bytes(b"PAR1 and no more")
    running.run(Campaign(campaign), folder, 1)
    assert sorted(p.name for p in folder.iterdir()) == [".lock", "campaign.json", "results.parquet"]
    assert digest(folder) == expected


def test_row_groups_do_not_depend_on_kills(written, tmp_path, monkeypatch):
    monkeypatch.setattr(store, "GROUP_ROWS", 9)
    campaign = spec.load(written())
    running.run(Campaign(campaign), tmp_path / "a", 1)
    file = pq.ParquetFile(tmp_path / "a" / "results.parquet")
    assert [file.metadata.row_group(i).num_rows for i in range(file.num_row_groups)] == [16, 8]


def test_another_spec_in_the_folder_is_refused(reference, tmp_path, written, capsys):
    folder = tmp_path / "reference"
    changed = written(poses="poses = 20", sigma_pos_mm="sigma_pos_mm = 0.03")
    assert main(["campaign", str(changed), "-o", str(folder)]) == 2
    message = capsys.readouterr().err
    assert "belongs to another campaign" in message and "plan.poses: 14 → 20" in message
    assert "instrument.sigma_pos_mm: 0.02 → 0.03" in message and "use another folder" in message


def test_comments_are_no_change(reference, tmp_path, written):
    spec_file = written("# what I was thinking\n" + written.small + "\n# and more\n")
    assert running.run(Campaign(spec.load(spec_file)), tmp_path / "reference", 1).trials == 0


def test_other_versions_are_refused(reference, tmp_path, monkeypatch):
    campaign, _ = reference
    ours = study.versions()
    monkeypatch.setattr(store, "versions", lambda: {**ours, "numpy": "1.0"})
    with pytest.raises(InputError, match=r"versions differ: numpy: \"[\d.]+\" → \"1.0\""):
        running.run(Campaign(campaign), tmp_path / "reference", 1)


def test_a_folder_with_other_things_is_left_alone(written, tmp_path):
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "thesis.tex").touch()
    with pytest.raises(InputError, match=r"holds other things \(thesis.tex\)"):
        running.run(Campaign(spec.load(written())), tmp_path / "home", 1)
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot write here"):
        running.run(Campaign(spec.load(written())), tmp_path / "file", 1)


def test_one_campaign_per_folder(reference, tmp_path):
    campaign, _ = reference
    with store.opened(Campaign(campaign), tmp_path / "reference"):
        with pytest.raises(InputError, match="another run is writing"):
            running.run(Campaign(campaign), tmp_path / "reference", 1)


def test_a_full_disk(written, tmp_path):
    """The system refuses to write more than 9 kB to a file: parts fit, the results do not."""
    spec_file = written()
    code = (
        "import resource, signal, sys; from bench.cli import main; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (9000, 9000)); sys.exit(main())"
    )
    arguments = ["campaign", str(spec_file), "-o", str(tmp_path / "full"), "--workers", "1", "--no-figures"]
    command = [sys.executable, "-c", code, *arguments]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert ended.returncode == 2 and "Traceback" not in ended.stderr
    assert "cannot write" in ended.stderr and "run the same command again" in ended.stderr
    assert not list((tmp_path / "full").rglob("results.parquet"))
    running.run(Campaign(spec.load(spec_file)), tmp_path / "full", 1)
    running.run(Campaign(spec.load(spec_file)), tmp_path / "whole", 1)
    assert digest(tmp_path / "full") == digest(tmp_path / "whole")


@pytest.mark.parametrize("n_workers", ["1", "2"])
def test_interrupted(written, tmp_path, n_workers):
    spec_file = written(robots="robots = 400", part_robots="part_robots = 1")
    process = begun(spec_file, tmp_path / "out", "--workers", n_workers)
    parts = tmp_path / "out" / "parts"
    while not finished(parts):
        time.sleep(0.01)
        assert process.poll() is None
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    out, err = process.communicate(timeout=WAIT)
    assert process.returncode == 130 and err.decode().strip() == "interrupted"
    kept = len(finished(parts))
    assert f"{kept} of 400 robots are kept; the same command goes on from there" in out.decode()
    with pytest.raises(ProcessLookupError):  # no worker is left behind
        deadline = time.monotonic() + WAIT
        while time.monotonic() < deadline:
            os.killpg(process.pid, 0)
            time.sleep(0.05)


def test_quiet_when_nobody_looks(written, tmp_path):
    process = begun(written(), tmp_path / "out", "--workers", "1")
    out, err = process.communicate(timeout=WAIT)
    assert process.returncode == 0 and err == b""
    assert "robots/s" in out.decode() and "complete" in out.decode()


def test_a_robot_that_kills_its_process_is_recorded(written, tmp_path, monkeypatch):
    """The pool tells which part died (tests/bench/test_pool.py), and then which robot of it."""
    campaign = Campaign(spec.load(written()))

    def deadly(work, tasks, workers):
        for task in tasks:
            yield task, pool.DiedError(-9) if 3 in task[2] else work(task)

    monkeypatch.setattr(pool, "unordered", deadly)
    running.run(campaign, tmp_path / "out", 2)
    table = pq.read_table(tmp_path / "out" / "results.parquet")
    told = dict(zip(table["robot"].to_pylist(), table["reason"].to_pylist(), strict=True))
    assert told == dict.fromkeys(range(6), "") | {3: running.DIED} and len(table) == 24


def test_a_campaign_that_gives_nothing_says_so(written, tmp_path, capsys):
    spec_file = written(poses="poses = 1")
    assert main(["campaign", str(spec_file), "-o", str(tmp_path / "out"), "--workers", "1", "--no-figures"]) == 1
    assert "rows failed: too few poses" in capsys.readouterr().out


def test_workers_have_one_thread_for_linear_algebra(written, monkeypatch):
    from threadpoolctl import threadpool_info

    seen = []
    monkeypatch.setattr(trial, "run", lambda *_: seen.extend(pool["num_threads"] for pool in threadpool_info()) or [])
    np.linalg.solve(np.eye(3), np.ones(3))
    study.rows(Campaign(spec.load(written())), [0])
    assert seen and set(seen) == {1}
