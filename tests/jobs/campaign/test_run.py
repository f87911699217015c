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
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from bench.cli import main
from bench.jobs.campaign import run, spec, store, trial, workers
from pcalib.errors import InputError

ROOT = Path(__file__).parents[3]
COMMAND = [sys.executable, "-c", "import sys; from bench.cli import main; sys.exit(main())", "campaign"]


def digest(folder: Path) -> str:
    return hashlib.sha256((folder / "results.parquet").read_bytes()).hexdigest()


def begun(spec_file: Path, folder: Path, *options: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [*COMMAND, str(spec_file), "-o", str(folder), "--no-figures", *options],
        cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True,
    )  # fmt: skip


@pytest.fixture
def reference(written, tmp_path) -> tuple[spec.Campaign, str]:
    """The small campaign and the digest of its results, done in this process."""
    campaign = spec.load(written())
    run.run(campaign, tmp_path / "reference", 1, inside=True)
    return campaign, digest(tmp_path / "reference")


def test_what_a_campaign_leaves(reference, tmp_path):
    campaign, _ = reference
    folder = tmp_path / "reference"
    assert sorted(p.name for p in folder.iterdir()) == [".lock", "campaign.json", "results.parquet"]
    table = pq.read_table(folder / "results.parquet")
    assert len(table) == 6 * 2 * 2
    assert table["robot"].to_pylist() == sorted(table["robot"].to_pylist())
    about = json.loads(table.schema.metadata[store.KEY])
    assert about["seed"] == 11 and about["spec"] == json.loads(campaign.source)
    assert {"numpy", "mujoco", "pcalib", "python"} <= set(about["versions"])
    kept = [errors is not None for errors in table["error_um"].to_pylist()]
    assert kept == [robot < 1 for robot in table["robot"].to_pylist()]  # map_robots = 1


@pytest.mark.parametrize("n_workers", [1, 2])
def test_any_number_of_workers(reference, tmp_path, n_workers):
    campaign, expected = reference
    done: list[int] = []
    outcome = run.run(campaign, tmp_path / "pool", n_workers, progress=done.append)
    assert digest(tmp_path / "pool") == expected
    assert outcome.trials == sum(done) == 6 and outcome.rate > 0


def test_killed_at_random_moments(written, tmp_path):
    """SIGKILL, workers included or left behind, again and again; what was finished stays, and the end is the same."""
    spec_file = written(robots="robots = 24", part_robots="part_robots = 1")
    run.run(spec.load(spec_file), tmp_path / "whole", 1, inside=True)
    folder, rng, kills = tmp_path / "killed", random.Random(7), 0
    parts = folder / "parts"
    for attempt in range(20):
        process = begun(spec_file, folder, "--workers", "2" if attempt == 1 else "1")
        had = len(list(parts.glob("*.parquet"))) if parts.is_dir() else 0
        enough = had + rng.randint(1, 5) if kills < 3 else 99
        while process.poll() is None:
            if parts.is_dir() and len(list(parts.glob("*.parquet"))) >= enough:
                time.sleep(rng.random() * 0.03)
                (os.kill if attempt == 1 else os.killpg)(process.pid, signal.SIGKILL)  # workers left behind, or not
                break
            time.sleep(0.002)
        process.communicate(timeout=30)
        if process.returncode == 0:
            break
        assert process.returncode == -signal.SIGKILL
        kills += 1
        assert len(list(parts.glob("*.parquet"))) >= had
        with (parts / ".000099.parquet.litter.parquet").open("wb") as litter:  # of a write that was cut short
            litter.write(b"PAR1")
    assert kills >= 3
    assert digest(folder) == digest(tmp_path / "whole")
    assert sorted(p.name for p in folder.iterdir()) == [".lock", "campaign.json", "results.parquet", "summary.csv"]


def test_a_part_cut_short_is_done_anew(reference, tmp_path, monkeypatch):
    campaign, expected = reference
    folder = tmp_path / "cut"
    done: list[int] = []
    monkeypatch.setattr(store.Store, "finish", lambda self: None)  # killed just before the end
    run.run(campaign, folder, 1, inside=True)
    part = folder / "parts" / "000001.parquet"
    part.write_bytes(part.read_bytes()[:-100])
    (folder / "parts" / "000002.parquet").write_bytes(b"")
    monkeypatch.undo()
    run.run(campaign, folder, 1, progress=done.append, inside=True)
    assert done == [2, 2, 2] and digest(folder) == expected  # one part was there, two are done


def test_parts_that_were_cut_up_in_another_way_are_done_anew(reference, tmp_path, monkeypatch):
    campaign, expected = reference
    other = replace(campaign, output=replace(campaign.output, part_robots=3))  # as a version with another default would
    monkeypatch.setattr(store.Store, "finish", lambda self: None)
    monkeypatch.setattr(spec, "parse", lambda source: other)
    run.run(other, tmp_path / "cut", 1, inside=True)
    monkeypatch.undo()
    assert len(list((tmp_path / "cut" / "parts").iterdir())) == 2
    run.run(campaign, tmp_path / "cut", 1, inside=True)
    assert digest(tmp_path / "cut") == expected


def test_a_finished_campaign_is_not_done_again(reference, tmp_path, capsys, written, monkeypatch):
    campaign, expected = reference
    monkeypatch.setattr(workers, "perform", None)
    assert run.run(campaign, tmp_path / "reference", 1, inside=True).trials == 0
    assert main(["campaign", str(written()), "-o", str(tmp_path / "reference"), "--no-figures"]) == 0
    assert "all robots were done before" in capsys.readouterr().out
    assert digest(tmp_path / "reference") == expected


def test_results_cut_short_are_made_anew_from_the_parts(reference, tmp_path, monkeypatch):
    campaign, expected = reference
    folder = tmp_path / "merge"
    monkeypatch.setattr(store.Store, "finish", lambda self: None)
    run.run(campaign, folder, 1, inside=True)
    (folder / "results.parquet").write_bytes(b"PAR1 and no more")
    monkeypatch.undo()
    run.run(campaign, folder, 1, inside=True)
    assert digest(folder) == expected


def test_what_a_kill_leaves_while_results_are_made_goes(reference, tmp_path):
    campaign, expected = reference
    folder = tmp_path / "reference"
    for name in (".results.parquet.a1b2.parquet", ".campaign.json.c3d4.json"):
        (folder / name).write_bytes(b"PAR1 and no more")
    run.run(campaign, folder, 1, inside=True)
    assert sorted(p.name for p in folder.iterdir()) == [".lock", "campaign.json", "results.parquet"]
    assert digest(folder) == expected


def test_row_groups_do_not_depend_on_kills(written, tmp_path, monkeypatch):
    monkeypatch.setattr(store, "GROUP_ROWS", 9)
    campaign = spec.load(written())
    run.run(campaign, tmp_path / "a", 1, inside=True)
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
    assert run.run(spec.load(spec_file), tmp_path / "reference", 1, inside=True).trials == 0


def test_other_versions_are_refused(reference, tmp_path, monkeypatch):
    campaign, _ = reference
    ours = store.versions()
    monkeypatch.setattr(store, "versions", lambda: {**ours, "numpy": "1.0"})
    with pytest.raises(InputError, match=r"versions differ: numpy: \"[\d.]+\" → \"1.0\""):
        run.run(campaign, tmp_path / "reference", 1, inside=True)


def test_a_folder_with_other_things_is_left_alone(written, tmp_path):
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "thesis.tex").touch()
    with pytest.raises(InputError, match=r"holds other things \(thesis.tex\)"):
        run.run(spec.load(written()), tmp_path / "home", 1, inside=True)
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be made"):
        run.run(spec.load(written()), tmp_path / "file", 1, inside=True)


def test_one_campaign_per_folder(reference, tmp_path):
    campaign, _ = reference
    with store.opened(campaign, tmp_path / "reference"):
        with pytest.raises(InputError, match="another campaign is writing"):
            run.run(campaign, tmp_path / "reference", 1, inside=True)


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
    run.run(spec.load(spec_file), tmp_path / "full", 1, inside=True)
    run.run(spec.load(spec_file), tmp_path / "whole", 1, inside=True)
    assert digest(tmp_path / "full") == digest(tmp_path / "whole")


@pytest.mark.parametrize("n_workers", ["1", "2"])
def test_interrupted(written, tmp_path, n_workers):
    spec_file = written(robots="robots = 400", part_robots="part_robots = 1")
    process = begun(spec_file, tmp_path / "out", "--workers", n_workers)
    parts = tmp_path / "out" / "parts"
    while not (parts.is_dir() and list(parts.glob("*.parquet"))):
        time.sleep(0.01)
        assert process.poll() is None
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130 and err.decode().strip() == "interrupted"
    kept = len(list(parts.glob("*.parquet")))
    assert f"{kept} of 400 robots are kept; the same command goes on from there" in out.decode()
    with pytest.raises(ProcessLookupError):  # no worker is left behind
        deadline = time.monotonic() + 5
        while time.monotonic() < deadline:
            os.killpg(process.pid, 0)
            time.sleep(0.05)


def test_quiet_when_nobody_looks(written, tmp_path):
    process = begun(written(), tmp_path / "out", "--workers", "1")
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0 and err == b""
    assert "robots/s" in out.decode() and "complete" in out.decode()


@pytest.mark.parametrize("n_workers", [2])
def test_a_robot_that_kills_its_process_is_recorded(written, tmp_path, monkeypatch, n_workers):
    """Through real processes, which find the deadly robot by themselves."""
    campaign = spec.load(written(robots="robots = 2"))
    monkeypatch.setenv("DEADLY_ROBOT", "1")
    monkeypatch.setattr(workers, "DEATHS", 1)
    monkeypatch.setattr(workers, "perform", deadly)
    monkeypatch.setattr(workers, "_alone", deadly_alone)
    run.run(campaign, tmp_path / "out", n_workers)
    table = pq.read_table(tmp_path / "out" / "results.parquet")
    assert dict(zip(table["robot"].to_pylist(), table["reason"].to_pylist(), strict=True)) == {0: "", 1: workers.DIED}
    assert len(table) == 8


def deadly(source: str, part: int) -> bytes:
    """A worker's task that dies with one robot."""
    campaign = spec.parse(source)
    if int(os.environ["DEADLY_ROBOT"]) in campaign.parts()[part]:
        os.kill(os.getpid(), signal.SIGKILL)
    return store.encode(campaign, part, workers.rows(campaign, campaign.parts()[part]))


def deadly_alone(source: str, number: int):
    """The same for a robot alone."""
    if int(os.environ["DEADLY_ROBOT"]) == number:
        os.kill(os.getpid(), signal.SIGKILL)
    return workers.rows(spec.parse(source), [number])


def test_a_campaign_that_gives_nothing_says_so(written, tmp_path, capsys):
    spec_file = written(poses="poses = 1")
    assert main(["campaign", str(spec_file), "-o", str(tmp_path / "out"), "--workers", "1", "--no-figures"]) == 1
    assert "rows failed: too few poses" in capsys.readouterr().out


def test_workers_have_one_thread_for_linear_algebra(written, monkeypatch):
    from threadpoolctl import threadpool_info

    seen = []
    monkeypatch.setattr(trial, "run", lambda *_: seen.extend(pool["num_threads"] for pool in threadpool_info()) or [])
    np.linalg.solve(np.eye(3), np.ones(3))
    workers.rows(spec.load(written()), [0])
    assert seen and set(seen) == {1}
