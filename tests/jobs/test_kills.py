"""A command that is killed leaves nothing by halves, and ends with the same bytes when it is given again."""

import json

from bench.jobs.attack import kills


def test_a_simulation_that_is_killed_ends_as_one_left_alone(tmp_path):
    out = tmp_path / "kills.json"
    assert kills.main(["--only", "simulate", "--kills", "1", "--json", str(out)]) == 0
    found = json.loads(out.read_text())
    assert found["held"] and sum(found["commands"]["simulate"]["kills"].values()) == 1


def test_only_known_commands_are_killed(capfd):
    assert kills.main(["--only", "inspect"]) == 2
    assert "these are" in capfd.readouterr().err
