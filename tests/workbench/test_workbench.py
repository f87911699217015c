"""The workbench over HTTP: who may ask, what may be asked, and that its figures are the commands' own."""

from __future__ import annotations

import base64
import http.client
import json
import shutil
import subprocess
import sys
import threading
import time
from dataclasses import replace

import pytest

from pcalib.cli import main
from pcalib.errors import InputError
from pcalib.workbench import actions, server, session
from pcalib.workbench.actions import Task
from pcalib.workbench.server import Workbench
from pcalib.workbench.worker import Worker


def ask(port: int, path: str, method: str = "GET", body: bytes = b"", **headers: str) -> tuple[int, bytes, dict]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    sent = {"Origin": f"http://127.0.0.1:{port}"} if method == "POST" else {}
    sent |= {name.replace("_", "-"): value for name, value in headers.items()}
    connection.request(method, path, body, {k: v for k, v in sent.items() if v})
    answer = connection.getresponse()
    return answer.status, answer.read(), dict(answer.headers)


def settled(bench: Workbench, seconds: float = 240.0) -> list:
    end = time.monotonic() + seconds
    while any(j.state in ("runs", "waits") for j in bench.worker.jobs()):
        assert time.monotonic() < end, [j.state for j in bench.worker.jobs()]
        time.sleep(0.1)
    return bench.worker.jobs()


class TestWhoMayAsk:
    def test_the_page_is_shown_to_who_has_its_address(self, running):
        port, bench = running
        status, page, headers = ask(port, f"/{bench.token}/")
        assert status == 200 and b"<title>pcalib workbench" in page
        assert "script-src 'self'" in headers["Content-Security-Policy"] and "http:" not in page.decode()
        for path in ("app.js", "style.css", "state"):
            assert ask(port, f"/{bench.token}/{path}")[0] == 200

    @pytest.mark.parametrize("path", ["/", "/state", "/wrong/state", "/wrong/"])
    def test_without_the_token_nothing_is_said(self, running, path):
        status, said, _ = ask(running[0], path)
        assert status == 403 and b"data.csv" not in said

    @pytest.mark.parametrize("host", ["evil.example", "127.0.0.1", "evil.example:{port}", "localhost:1"])
    def test_other_names_of_the_server_are_refused(self, running, host):
        """A name of another site that leads here must not open the page to that site."""
        port, bench = running
        assert ask(port, f"/{bench.token}/state", Host=host.format(port=port))[0] == 403

    @pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1", "", "https://localhost"])
    def test_pages_from_elsewhere_cannot_change_anything(self, running, origin):
        port, bench = running
        assert ask(port, f"/{bench.token}/example", "POST", Origin=origin)[0] == 403
        assert not (bench.folder / "data.csv").exists()

    def test_pages_from_elsewhere_cannot_read(self, running):
        port, bench = running
        status, _, headers = ask(port, f"/{bench.token}/state", Origin="http://evil.example")
        assert status == 403 and "Access-Control-Allow-Origin" not in headers


class TestFiles:
    @pytest.mark.parametrize(
        "name", ["../x.csv", "/etc/passwd", ".hidden", "a/b.csv", "..", "<b>.csv", "a\x00.csv", ""]
    )
    def test_names_that_lead_elsewhere_are_no_names(self, running, name):
        port, bench = running
        quoted = "".join(f"%{b:02x}" for b in name.encode())
        assert ask(port, f"/{bench.token}/upload?name={quoted}", "POST", b"x")[0] == 400
        assert ask(port, f"/{bench.token}/file?name={quoted}")[0] == 404
        assert sorted(f.name for f in bench.folder.iterdir()) == []

    def test_a_link_is_not_followed(self, running, tmp_path):
        port, bench = running
        (tmp_path / "secret.csv").write_text("secret")
        (bench.folder / "link.csv").symlink_to(tmp_path / "secret.csv")
        status, said, _ = ask(port, f"/{bench.token}/file?name=link.csv")
        assert status == 404 and b"secret" not in said

    def test_too_much_is_refused_before_it_is_read(self, running):
        port, bench = running
        status, said, _ = ask(port, f"/{bench.token}/upload?name=a.csv", "POST", Content_Length=str(2**40))
        assert status == 413 and b"MiB" in said

    def test_reports_may_run_nothing(self, running):
        port, bench = running
        (bench.folder / "model1.html").write_text("<script>alert(1)</script>")
        _, _, headers = ask(port, f"/{bench.token}/file?name=model1.html")
        policy = headers["Content-Security-Policy"]
        assert "sandbox" in policy and "default-src 'none'" in policy and "script-src" not in policy

    def test_robot_and_data_are_told_apart(self):
        assert session.kind_of("delta.toml", b"") == "robot"
        assert session.kind_of("poses.csv", b"q1_deg,x_mm\n") == "data"


    @pytest.mark.parametrize("place", ["data", "robot", "model"])
    def test_no_name_in_a_record_becomes_an_option(self, tmp_path, place):
        """A folder may come from elsewhere: what stands in it must not choose which code runs."""
        step = session.ModelStep("complete", "model1.toml", {}, "model1.html")
        now = session.Session("d.csv", "r.toml", (step,), at=0, source=tmp_path)
        bad = "--effect-file=evil.py"
        changed = replace(now, steps=(replace(step, model=bad),)) if place == "model" else replace(now, **{place: bad})
        session.save(changed)
        with pytest.raises(InputError, match="no name for a file"):
            session.load(tmp_path)

    def test_the_same_file_again_changes_nothing(self, running):
        """A session is begun again with the data and the robot that it has already."""
        _, bench = running
        bench.take("robot.toml", b"[geometry]")
        step = session.ModelStep("complete", "model1.toml", {}, "model1.html")
        session.save(replace(session.load(bench.folder), data="d.csv", steps=(step,), at=0))
        again = Workbench(bench.folder)
        again.take("robot.toml", b"[geometry]")
        assert session.load(bench.folder).steps == (step,)
        again.take("robot.toml", b"[geometry] # another")
        assert session.load(bench.folder).steps == ()
        again.worker.close()


class TestActions:
    def test_a_step_on_an_earlier_one_says_so_and_takes_no_name_that_is_there(self, tmp_path):
        steps = tuple(session.ModelStep(name, f"model{i}.toml", {}) for i, name in ((1, "complete"), (2, "+ backlash")))
        now = session.Session("d.csv", "r.toml", steps, at=0, source=tmp_path)
        (tmp_path / "model3.compare.json").touch()
        task = actions.task("add", now, {"effect": "gear_ratio"})
        assert task.model == "model4.toml"
        after = actions.done(now, task)
        assert [s.title for s in after.steps] == ["complete", "+ backlash", "1 + gear_ratio"] and after.at == 2

    def test_nothing_runs_before_there_is_data(self, running):
        port, bench = running
        status, said, _ = ask(port, f"/{bench.token}/run?action=fit", "POST")
        assert status == 400 and "data file" in json.loads(said)["problem"]
        assert ask(port, f"/{bench.token}/run?action=rm", "POST")[0] == 400

    def test_what_is_asked_for_cannot_become_an_option(self, tmp_path):
        now = session.Session("d.csv", "r.toml", (session.ModelStep("complete", "model1.toml", {}),), source=tmp_path)
        assert actions.task("add", now, {"effect": "backlash"}).words[:4] == ("add", "backlash", "d.csv", "--model")
        with pytest.raises(InputError, match="is no effect"):
            actions.task("add", now, {"effect": "--report"})
        with pytest.raises(InputError, match="is no targets"):
            actions.task("compensate", now, {"targets": "--effect-file=x.py"})

    @pytest.mark.parametrize("spec", ["x.py:Mine", "laws/x.py:Mine", "../x.py", "a,x.py:Mine", "gear_ratio;x"])
    @pytest.mark.parametrize("action", ["look", "try", "add", "plan"])
    def test_no_code_of_a_file_runs_from_a_page_or_from_a_record(self, tmp_path, action, spec):
        now = session.Session("d.csv", "r.toml", (session.ModelStep("complete", "model1.toml", {}),), source=tmp_path)
        asked = {"between": f"backlash,{spec}"} if action == "plan" else {"effect": spec}
        with pytest.raises(InputError, match="is no listed effect"):
            actions.task(action, now, asked)
        with pytest.raises(InputError, match="is no listed effect"):
            actions.queue([session.Wanted(action, asked)], now)

    def test_what_was_begun_is_written_again_under_its_name(self, tmp_path):
        wanted = (session.Wanted("fit", {}, "model1.toml"), session.Wanted("compare", {}))
        session.save(session.Session("d.csv", "r.toml", pending=wanted, source=tmp_path))
        (tmp_path / "model1.html").write_text("of the fit that was killed")
        now = session.load(tmp_path)
        fit, compare = actions.queue(now.pending, now)
        assert fit.model == "model1.toml" and compare.words[2:4] == ("--model", "model1.toml")
        assert actions.task("fit", now, {}).model == "model2.toml"  # a new one takes no name that is there

    def test_a_record_names_no_other_file_to_write(self, tmp_path):
        wanted = (session.Wanted("fit", {}, "../r.toml"),)
        session.save(session.Session("d.csv", "r.toml", pending=wanted, source=tmp_path))
        now = session.load(tmp_path)
        assert actions.queue(now.pending, now)[0].model == "model1.toml"

    @pytest.mark.parametrize("spec", ["thermal_rods", "encoder_eccentricity:arm", "gear_ripple:arm@17.3"])
    def test_listed_effects_and_their_variants_run(self, tmp_path, spec):
        now = session.Session("d.csv", "r.toml", (session.ModelStep("complete", "model1.toml", {}),), source=tmp_path)
        assert actions.task("add", now, {"effect": spec}).words[1] == spec

    def test_a_command_that_fails_takes_those_behind_it_along(self, tmp_path):
        ended: list[Task] = []
        worker = Worker(tmp_path, ended.append)
        for words in (("inspect", "no.csv", "--robot", "no.toml"), ("effect", "list")):
            worker.add(Task("inspect", "…", words))
        while any(j.state in ("runs", "waits") for j in worker.jobs()):
            time.sleep(0.05)
        first, second = worker.jobs()
        assert first.state == "failed" and "no such file" in first.said and second.state == "cancelled" and not ended
        worker.close()


def test_the_whole_loop_and_its_script(running, tmp_path):
    """From the example to the effect that was hidden in it; the script of the session makes the same bytes."""
    port, bench = running
    assert ask(port, f"/{bench.token}/example", "POST")[0] == 200
    assert [j.state for j in settled(bench)] == ["done"] * 5
    state = json.loads(ask(port, f"/{bench.token}/state")[1])
    assert state["written"]["diagnose"]["established"] == ["thermal_rods"]
    before = state["steps"][0]["figures"]
    assert before["rms"] == json.loads((bench.folder / "model1.json").read_text())["rms_pos_um"]

    ask(port, f"/{bench.token}/run?action=add&effect=thermal_rods", "POST")
    settled(bench)
    state = json.loads(ask(port, f"/{bench.token}/state")[1])
    after = state["steps"][1]["figures"]
    assert after["rms"] < 0.5 * before["rms"] and after["rms_check"] < 0.6 * before["rms_check"]
    assert state["written"]["diagnose"]["verdict"] == "nothing_missing" and state["at"] == 1

    again = session.load(bench.folder)  # as after a kill: the record alone
    assert [s.title for s in again.steps] == ["complete", "+ thermal_rods"]
    ask(port, f"/{bench.token}/at?step=0", "POST")
    ask(port, f"/{bench.token}/back", "POST")
    assert len(session.load(bench.folder).steps) == 1

    fresh = tmp_path / "fresh"
    fresh.mkdir()
    for name in ("data.csv", "robot.toml"):
        shutil.copy(bench.folder / name, fresh)
    script = ask(port, f"/{bench.token}/session.py")[1].decode()
    kept = [line for line in script.splitlines() if not line.startswith("run(") or "'fit'" in line or "'add'" in line]
    subprocess.run([sys.executable, "-c", "\n".join(kept)], cwd=fresh, check=True, capture_output=True)
    for name in ("model1.toml", "model2.toml"):
        assert (fresh / name).read_bytes() == (bench.folder / name).read_bytes()


class TestMoreRows:
    def test_rows_are_joined_and_every_step_is_made_again(self, tmp_path):
        now = session.Session("d.csv", "r.toml", source=tmp_path)
        for action, asked in (("fit", {"level": "model24"}), ("add", {"effect": "backlash"})):
            now = actions.done(now, actions.task(action, now, asked))
        again = actions.tasks("more", now, {"rows": "new.csv"})
        assert [t.words[0] for t in again] == ["join", "inspect", "fit", "add", "compare", "diagnose", "view"]
        join, _, fit, add, *_ = (t.words for t in again)
        assert join[:5] == ("join", "d.csv", "new.csv", "-o", "joined1.csv")
        assert fit[:6] == ("fit", "joined1.csv", "--robot", "r.toml", "--level", "model24")
        assert add[:3] == ("add", "backlash", "joined1.csv")
        for task in again:
            now = actions.done(now, task)
        assert now.data == "joined1.csv" and [s.title for s in now.steps] == ["fit", "+ backlash"]

    def test_what_is_joined_cannot_become_an_option_or_take_the_datas_name(self, running, tmp_path):
        now = session.Session("d.csv", "r.toml", source=tmp_path)
        with pytest.raises(InputError, match="is no rows"):
            actions.task("join", now, {"rows": "--output=r.toml"})
        port, bench = running
        assert ask(port, f"/{bench.token}/upload?name=d.csv", "POST", b"q1_deg\n")[0] == 200
        status, said, _ = ask(port, f"/{bench.token}/upload?name=d.csv&as=rows", "POST", b"other\n")
        assert status == 400 and b"file of this session" in said
        assert (bench.folder / "d.csv").read_bytes() == b"q1_deg\n"
        status, said, _ = ask(port, f"/{bench.token}/upload?name=new.csv&as=rows", "POST", b"nonsense\n")
        assert status == 400 and json.loads(said)["problem"] and not (bench.folder / "new.csv").exists()


class TestForOthers:
    def test_the_password_is_asked_for(self, tmp_path):
        served, bench = server.serve(tmp_path / "s", host="127.0.0.2", password="a long password")
        threading.Thread(target=lambda: served.serve_forever(0.02), daemon=True).start()
        try:
            base, host = f"/{bench.token}/state", f"127.0.0.2:{served.server_port}"
            known = {"Host": host, "Authorization": f"Basic {base64.b64encode(b'me:a long password').decode()}"}
            wrong = known | {"Authorization": f"Basic {base64.b64encode(b'me:another').decode()}"}
            answers = []
            for headers in ({"Host": host}, wrong, known | {"Authorization": "Basic ?"}, known, known | {"Host": "x"}):
                connection = http.client.HTTPConnection("127.0.0.2", served.server_port, timeout=30)
                connection.request("GET", base, headers=headers)
                answers.append(connection.getresponse().status)
            assert answers == [401, 401, 401, 200, 403]
            assert bench.viewer == "" and server.address(served, bench).startswith(f"http://{host}/")
        finally:
            served.shutdown()
            served.server_close()
            bench.worker.close()

    @pytest.mark.parametrize(
        ("words", "mode", "password", "says"),
        [
            (["--host", "10.0.0.1"], 0, "", "go together"),
            (["--password-file", "p"], 0o600, "long enough it is", "go together"),
            (["--host", "10.0.0.1", "--password-file", "p"], 0o644, "long enough it is", "others can read"),
            (["--host", "10.0.0.1", "--password-file", "p"], 0o600, "short", "fewer than 12"),
            (["--host", "0.0.0.0", "--password-file", "p"], 0o600, "long enough it is", "no address"),
            (["--host", "192.0.2.1", "--password-file", "p"], 0o600, "long enough it is", "address of this computer"),
        ],
    )
    def test_a_page_for_others_needs_a_good_password(self, tmp_path, monkeypatch, capsys, words, mode, password, says):
        monkeypatch.chdir(tmp_path)
        (tmp_path / "p").write_text(password)
        (tmp_path / "p").chmod(mode or 0o600)
        assert main(["workbench", "--no-browser", *words]) == 2
        assert says in " ".join(capsys.readouterr().err.split())


class TestColumns:
    def test_columns_are_named_by_a_line_above_the_header(self, running):
        port, bench = running
        bench.take("d.csv", b"# columns = a,b\nJ1;Xm\n1,5;-800\n")
        said = json.loads(ask(port, f"/{bench.token}/columns")[1])
        assert said["columns"] == ["J1", "Xm"] and "q1_deg" in said["known"]
        bench.name_columns("q1_deg, x_mm")
        assert (bench.folder / "d.csv").read_text() == "# columns = q1_deg,x_mm\nJ1;Xm\n1,5;-800\n"

    @pytest.mark.parametrize("names", ["q1_deg", "q1_deg,q1_deg", "q1_deg,", "q1_deg,x\n# frame = tracker", "a,b;c"])
    def test_wrong_names_change_nothing(self, running, names):
        _, bench = running
        bench.take("d.csv", b"J1;Xm\n1,5;-800\n")
        with pytest.raises(InputError):
            bench.name_columns(names)
        assert (bench.folder / "d.csv").read_bytes() == b"J1;Xm\n1,5;-800\n"

    def test_without_data_it_is_said(self, running):
        port, bench = running
        assert ask(port, f"/{bench.token}/columns")[0] == 400
        assert ask(port, f"/{bench.token}/columns?names=a", "POST")[0] == 400


class TestLaws:
    LAW = "laws/tool_by_time.py:ToolByTime"

    def begun(self, bench):
        (bench.folder / "laws").mkdir()
        (bench.folder / "laws" / "tool_by_time.py").write_text("class ToolByTime: pass\n")
        step = session.ModelStep("complete", "model1.toml", {}, "model1.html")
        return session.Session("d.csv", "r.toml", (step,), at=0, source=bench.folder)

    def test_a_law_runs_once_its_code_is_agreed_to_and_no_longer_than_it_stays_the_same(self, running):
        _, bench = running
        now = self.begun(bench)
        with pytest.raises(InputError, match="no listed effect"):
            actions.tasks("add", now, {"effect": self.LAW}, bench.agreed())
        bench.agree(self.LAW, bench.code(self.LAW)["digest"])
        added = actions.tasks("add", now, {"effect": self.LAW}, bench.agreed())
        assert added[0].words[:2] == ("add", self.LAW)
        assert all(t.words[-2:] == ("--effect-file", self.LAW) or "--effect-file" in t.words for t in added[1:])
        after = actions.done(now, added[0])
        assert after.steps[-1].title == "+ ToolByTime" and after.steps[-1].code == (self.LAW,)
        (bench.folder / "laws" / "tool_by_time.py").write_text("import os\n")
        assert bench.agreed() == []
        with pytest.raises(InputError, match="runs the code of"):
            actions.task("compare", after, {}, agreed=bench.agreed())

    def test_a_record_agrees_to_nothing(self, running):
        """A session's folder may come from elsewhere, with laws and with actions that wait."""
        _, bench = running
        now = self.begun(bench)
        step = replace(now.steps[0], code=(self.LAW,))
        waits = (session.Wanted("compare", {}),)
        session.save(replace(now, steps=(step,), pending=waits))
        again = Workbench(bench.folder)
        assert again.worker.pending() == [] and again.agreed() == []
        assert session.load(bench.folder).steps[0].code == (self.LAW,)
        again.worker.close()

    @pytest.mark.parametrize(
        "spec", ["laws/../x.py:A", "x.py:A", "laws/none.py:A", "laws/link.py:A", "/x.py:A", "laws/a.py"]
    )
    def test_only_laws_of_the_session_are_shown(self, running, tmp_path, spec):
        port, bench = running
        self.begun(bench)
        (tmp_path / "x.py").write_text("secret")
        (bench.folder / "laws" / "link.py").symlink_to(tmp_path / "x.py")
        status, said, _ = ask(port, f"/{bench.token}/code?spec={spec}")
        assert status == 400 and b"secret" not in said
        with pytest.raises(InputError, match="no law of this session"):
            bench.agree(spec, "0" * 64)

    def test_what_was_not_shown_is_not_agreed_to(self, running):
        _, bench = running
        self.begun(bench)
        with pytest.raises(InputError, match="not what was shown"):
            bench.agree(self.LAW, "0" * 64)
