"""The command line: what it prints and writes, exit statuses, nothing half-written."""

import json
import os
import re
import subprocess
import sys
import threading

import numpy as np
import pytest

from rotorjax import InputError, read_rig
from rotorjax.cli import main

from helpers import HEADER, RIG, ROWS, write


def run(*arguments) -> int:
    return main([str(a) for a in arguments])


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    folder = tmp_path_factory.mktemp("example") / "new"
    assert run("example", folder) == 0
    return folder


@pytest.fixture(scope="module")
def told(example):
    """The whole of `compare` on the example, once."""
    status = run(
        "compare", example / "measurement.csv", "--rig", example / "rig.toml", "--effect", "residual_unbalance",
        "--effect", "cross_coupling",
        "--json", example / "c.json", "--report", example / "r.html", "--write-rig", example / "fitted.toml",
    )  # fmt: skip
    assert status == 0
    return json.loads((example / "c.json").read_text(), parse_constant=lambda name: pytest.fail(f"{name} in JSON"))


def test_example_hides_two_effects_and_compare_finds_their_sizes(told):
    """Truth of tests/make_example.py: 9 g mm at 50°, 1200 N/m, stiffness along x 1 % up, sigma 0.3 µm."""
    assert told["before"]["rms_um"] > 80 * told["rms_um"]
    assert told["reduced_chi2"] == pytest.approx(1.0, abs=0.35)
    parameters = told["steps"][-1]["parameters"]
    assert parameters["cross_coupling"]["cross_stiffness_n_per_m"]["value"] == pytest.approx(1200.0, abs=35.0)
    unbalance = [parameters["residual_unbalance"][f"unbalance_{a}_kg_m"]["value"] * 1e6 for a in "xy"]
    np.testing.assert_allclose(unbalance, [9 * np.cos(np.radians(50)), 9 * np.sin(np.radians(50))], atol=0.1)
    assert parameters["stiffness_error"]["error_x"]["value"] == pytest.approx(0.01, abs=0.001)
    assert [step["added"] for step in told["steps"]] == [None, None, "residual_unbalance", "cross_coupling"]
    assert told["noise"] == "given"
    assert {"run", "speed", "probe", "order"} == set(told["share"])
    assert "within" in told["verdict"] or "what the noise allows" in told["verdict"]


def test_compare_states_critical_speeds_as_declared_and_with_what_was_added(told, example):
    """√(k / M) of the rig file, 2 % damping; then 1 % more stiffness along x, and cross-coupling."""
    before, after = told["critical_speeds"]["before"], told["critical_speeds"]["after"]
    np.testing.assert_allclose([c["speed_rpm"] for c in before], [2196.1, 2304.7], atol=0.1)
    np.testing.assert_allclose([c["damping_ratio"] for c in before], 0.02, rtol=1e-6)
    np.testing.assert_allclose([c["speed_rpm"] for c in after], [2202.0, 2311.0], atol=3.0)
    np.testing.assert_allclose([c["damping_ratio"] for c in after], 0.0199, atol=3e-4)
    np.testing.assert_allclose([c["amplification_factor"] * 2.0 * c["damping_ratio"] for c in after], 1.0)
    assert before[0]["amplitude_um"] is None
    assert after[0]["amplitude_um"]["Y"] > after[0]["amplitude_um"]["X"] > 100.0
    assert [c["separation_margin"] for c in after] == ["inside", "inside"]
    assert told["stability"]["speed_range_rpm"] == pytest.approx([700.0, 2800.0])
    assert told["stability"]["after"]["onset_rpm"] is None
    assert told["stability"]["after"]["log_decrement"] == pytest.approx(0.124, abs=0.003)
    assert "Critical speeds: 22" in (example / "r.html").read_text().split("<nav")[0]


def test_written_model_is_taken_by_compare(example, told, capsys):
    assert (
        run("compare", example / "measurement.csv", "--rig", example / "fitted.toml", "--json", example / "again.json")
        == 0
    )
    again = json.loads((example / "again.json").read_text())
    assert again["rms_um"] == pytest.approx(told["rms_um"], rel=1e-6)
    assert "within the noise" in capsys.readouterr().out


def test_a_reader_that_has_seen_enough_does_not_cost_the_files(example, tmp_path):
    """`rotorjax compare ... --json FILE | head -1`."""
    command = [
        sys.executable,
        "-m",
        "rotorjax.cli",
        "compare",
        example / "measurement.csv",
        "--rig",
        example / "rig.toml",
        "--json",
        tmp_path / "c.json",
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as called:
        assert called.stdout is not None
        assert called.stderr is not None
        called.stdout.close()
        assert called.stderr.read() == ""
        assert called.wait() == 0
    assert json.loads((tmp_path / "c.json").read_text())["rms_um"] > 0.0


def test_report_is_one_file_without_network(example, told):
    page = (example / "r.html").read_text()
    assert told["verdict"].split(".")[0][:40] in page
    assert not re.search(r'(src|href)="(?!data:|#)', page)
    assert all(f'id="{place}"' in page for place in re.findall(r'href="#(\w+)"', page))
    assert "http" not in page.replace("http-equiv", "")
    assert page.count("data:image/svg+xml;base64,") == 8
    assert "<script" not in page


def test_diagnose(example, told, capsys):
    assert (
        run(
            "diagnose",
            example / "measurement.csv",
            "--rig",
            example / "fitted.toml",
            "--reference",
            "baseline",
            "--json",
            example / "d.json",
        )
        == 0
    )
    found = json.loads((example / "d.json").read_text())
    trial = found["runs"]["trial-b"]
    assert trial["identifiable"]
    assert trial["unbalance_g_mm"]["value"] == pytest.approx(30.0, abs=0.5)
    assert trial["unbalance_g_mm"]["angle_deg"] == pytest.approx(120.0, abs=1.0)
    assert set(found["inherent"]) == set(trial)
    said = capsys.readouterr().out
    assert "trial-b" in said
    assert re.search(r"The rig file holds an unbalance of [89]\.\d+ g mm at (49|50)° already", said)
    # What the rig file holds is corrected with what was found on top of it.
    assert found["balance"]["disk"]["unbalance_g_mm"] == pytest.approx(9.0, abs=0.2)
    assert found["balance"]["disk"]["correction_angle_deg"] == pytest.approx(230.0, abs=1.5)
    assert "To balance: " in said
    assert found["no_correction"] is None
    # The weight is installed in trial-b; in the baseline nothing is left beyond what the rig file holds.
    assert trial["unbalance_g_mm"]["differs_from_zero"]
    assert not found["inherent"]["unbalance_g_mm"]["differs_from_zero"]
    assert found["inherent"]["unbalance_g_mm"]["below"] < 0.5
    assert re.search(r"baseline +below 0\.\d+ +- +below 0\.\d+ +- ", said)
    assert "inherent: " in said


def test_diagnose_makes_no_correction_of_what_is_not_there(example, told, capsys):
    """A damping that cannot be and no noise to judge it by: the interval is larger than the value."""
    rig, bare = (example / "rig.toml").read_text(), example / "bare.csv"
    heavy = example / "heavy.toml"
    heavy.write_text(rig.replace("damping_ratio = { x = 0.02, y = 0.02 }", "damping_ratio = 2.0"))
    bare.write_text(
        "".join(line.rsplit(",", 1)[0] + "\n" for line in (example / "measurement.csv").read_text().splitlines())
    )
    assert run("diagnose", bare, "--rig", heavy, "--json", example / "h.json") == 0
    said, found = capsys.readouterr().out, json.loads((example / "h.json").read_text())
    assert found["balance"] == {}
    assert "not different from zero" in found["no_correction"]
    assert found["no_correction"] in said
    assert "To balance" not in said
    assert "G " not in said
    # Influence coefficients need neither the rotor nor its damping.
    without_rotor = found["influence_coefficients"]["planes"]["disk"]
    assert without_rotor["unbalance_g_mm"] == pytest.approx(9.0, abs=0.1)
    assert without_rotor["correction_angle_deg"] == pytest.approx(230.0, abs=0.5)
    assert "without the rotor model: correction 9.0" in said
    assert found["runs"]["baseline"]["model_holds"] is None
    assert run("diagnose", bare, "--rig", example / "fitted.toml") == 0
    assert "To balance, if the model holds (which cannot be checked): " in capsys.readouterr().out
    assert run("diagnose", example / "measurement.csv", "--rig", heavy, "--json", example / "h.json") == 0
    said, found = capsys.readouterr().out, json.loads((example / "h.json").read_text())
    assert found["balance"] == {}
    assert found["runs"]["baseline"]["model_holds"] is False
    assert said.count("model fails") == 3
    assert "To balance" not in said


def test_simulate_like_and_compare(example, capsys):
    table = example / "sim.csv"
    like = ("simulate", "--rig", example / "rig.toml", "--like", example / "measurement.csv", "--output", table)
    assert run(*like, "--effect", "cross_coupling:cross_stiffness_n_per_m=858", "--noise-um", "0.2", "--seed", "3") == 0
    first = table.read_text()
    assert run(*like, "--effect", "cross_coupling:cross_stiffness_n_per_m=858", "--noise-um", "0.2", "--seed", "3") == 0
    assert table.read_text() == first
    assert first.splitlines()[0] == HEADER
    given = ("compare", table, "--rig", example / "rig.toml", "--effect", "cross_coupling:cross_stiffness_n_per_m=858")
    assert run(*given, "--json", example / "s.json") == 0
    assert json.loads((example / "s.json").read_text())["reduced_chi2"] == pytest.approx(1.0, abs=0.35)
    assert "cross_coupling.cross_stiffness" not in capsys.readouterr().out, "a given value is not fitted"


def test_simulate_speeds_without_noise(tmp_path):
    _, toml = write(tmp_path)
    assert (
        run("simulate", "--rig", toml, "--speeds", "600:900:3", "--orders", "1,2", "--output", tmp_path / "s.csv") == 0
    )
    lines = (tmp_path / "s.csv").read_text().splitlines()
    assert lines[0] == HEADER.replace(",sigma_um", "")
    assert len(lines) == 1 + 2 * 3 * 2 * 2


def test_help_names_every_command_and_each_has_its_own(capsys):
    with pytest.raises(SystemExit, match=r"^0$"):
        run("--help")
    commands = re.findall(r"^    ([a-z-]+)(?=$|  )", capsys.readouterr().out, re.MULTILINE)
    assert {"compare", "explain", "explain-many", "diagnose", "paper"} <= set(commands)
    for name in commands:
        with pytest.raises(SystemExit, match=r"^0$"):
            run(name, "--help")
        assert f"rotorjax {name}" in capsys.readouterr().out


def test_effects_and_version(capsys):
    assert run("effects") == 0
    assert run("effects", "foundation") == 0
    out = capsys.readouterr().out
    assert "residual_unbalance" in out
    assert "Kirk, Gunter" in out
    with pytest.raises(SystemExit) as ended:
        run("--version")
    assert ended.value.code == 0
    assert re.fullmatch(r"rotorjax \d+\.\d+\.\d+", capsys.readouterr().out.strip())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["effects", "cross"], "did you mean 'cross_coupling'?"),
        (
            ["compare", "{data}", "--rig", "{rig}", "--effect", "cros_coupling"],
            "unknown effect 'cros_coupling'; did you mean 'cross_coupling'?",
        ),
        (
            ["compare", "{data}", "--rig", "{rig}", "--effect", "mass_error:eror=0.1"],
            "mass_error has no parameter 'eror'; did you mean 'error'?",
        ),
        (["compare", "{data}", "--rig", "{rig}", "--effect", "mass_error:error=big"], "'big' is not a finite number"),
        (["compare", "{data}", "--rig", "{rig}", "--effect", "mass_error:error"], "'' is not a finite number"),
        (["compare", "{data}", "--rig", "none.toml"], "none.toml: No such file"),
        (
            ["diagnose", "{data}", "--rig", "{rig}", "--reference", "trial-z"],
            "reference run 'trial-z' is not in the table",
        ),
        (
            ["simulate", "--rig", "{rig}", "--speeds", "600-900", "--output", "{new}"],
            "--speeds 600-900: write LOW:HIGH:COUNT",
        ),
        (
            ["simulate", "--rig", "{rig}", "--speeds", "600:900:3", "--orders", "one", "--output", "{new}"],
            "--orders one",
        ),
        (
            ["simulate", "--rig", "{rig}", "--speeds", "600:900:3", "--noise-um", "-1", "--output", "{new}"],
            "--noise-um -1.0",
        ),
        (
            ["simulate", "--rig", "{rig}", "--speeds", "600:900:1000000000", "--output", "{new}"],
            "1000000000 speeds are too many",
        ),
        (["simulate", "--rig", "{rig}", "--speeds", "1e400:900:3", "--output", "{new}"], "write LOW:HIGH:COUNT"),
        (
            ["simulate", "--rig", "{rig}", "--speeds", "600:900:3", "--orders", "1e9", "--output", "{new}"],
            "no order is above 100",
        ),
        (
            ["simulate", "--rig", "{rig}", "--speeds", "600:900:3", "--seed", "9" * 30, "--output", "{new}"],
            "must be a whole number of at most",
        ),
        (["explain", "{data}", "--rig", "{rig}", "--only", ","], "--only: names no effect"),
        (["compare", "{folder}", "--rig", "{rig}"], "is a folder; give the path of a file in it"),
        (["example", "{folder}"], "exists already"),
        (["compare", "{data}", "--rig", "{rig}", "--json", "{data}"], "is read by the same command"),
        (["compare", "{data}", "--rig", "{rig}", "--write-rig", "{rig}"], "is read by the same command"),
        (
            ["compare", "{data}", "--rig", "{rig}", "--json", "{new}", "--report", "{new}"],
            "is written by the same command",
        ),
        (["compare", "{data}", "--rig", "{rig}", "--json", "{folder}"], "is a folder"),
        (["compare", "{data}", "--rig", "{rig}", "--report", "{folder}/none/r.html"], "does not exist"),
        (["compare", "{data}", "--rig", "{long}"], "File name too long; give the path of a readable file"),
        (["compare", "{data}\0", "--rig", "{rig}", "--json", "{new}"], "embedded null byte; choose another path"),
        (["explain-many", "{folder}", "--output", "{new}", "--reports", "{long}"], "too long; name a folder"),
        (["explain-many", "{long}", "--output", "{new}"], "File name too long; give a folder with tables"),
        (["vectors", "{long}", "--rig", "{rig}", "--output", "{new}"], "does not say which run it holds"),
        (["example", "{long}"], "cannot be made (File name too long); choose another folder"),
        (
            ["compare", "{data}", "--rig", "{rig}", "--effect", "mass_error", "--effect", "mass_error"],
            "mass_error is there already",
        ),
        (
            ["simulate", "--rig", "{rig}", "--speeds", "600:900:3", "--effect", "mass_error", "--output", "{new}"],
            "give its values",
        ),
        (["simulate", "--rig", "{rig}", "--speeds", "600:-100:5", "--output", "{new}"], "--speeds 600:-100:5"),
    ],
)
def test_bad_input(tmp_path, capsys, arguments, words):
    data, toml = write(tmp_path)
    taken = tmp_path / "taken"
    taken.mkdir()
    (taken / "rig.toml").write_text("mine")
    new = tmp_path / "new.csv"
    filled = [a.format(data=data, rig=toml, new=new, folder=taken, long=tmp_path / ("n" * 300)) for a in arguments]
    assert run(*filled) == 2
    caught = capsys.readouterr()
    assert words in caught.err
    assert "Traceback" not in caught.err
    assert not new.exists()
    assert (taken / "rig.toml").read_text() == "mine"


def test_what_is_no_plain_file_is_written_to_not_replaced(tmp_path):
    """A named pipe, as /dev/stdout may be one."""
    data, toml = write(tmp_path)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    read: list[str] = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_text(encoding="utf-8")))
    reader.start()
    assert run("compare", data, "--rig", toml, "--json", pipe) == 0
    reader.join(10.0)
    assert json.loads(read[0])["rms_um"] > 0.0
    assert pipe.is_fifo()


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_the_example_leaves_recordings_that_are_there(tmp_path, capsys, kind):
    mine = tmp_path / "recordings" / ("baseline-700.csv" if kind == "folder" else "")
    mine.parent.mkdir(exist_ok=True)
    mine.write_text("mine")
    assert run("example", tmp_path, "--recordings") == 2
    assert "recordings: exists already; give an empty folder" in capsys.readouterr().err
    assert mine.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [tmp_path / "recordings"]


def test_the_example_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    def refuse(*_: object) -> str:
        raise InputError("the disk is full")

    monkeypatch.setattr("rotorjax.data.example_recordings._recording", refuse)
    assert run("example", tmp_path, "--recordings") == 2
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc and /dev/full")
def test_outputs_that_cannot_be_written_are_refused_before_and_cost_no_other(tmp_path, capsys):
    data, toml = write(tmp_path)
    protected, report = tmp_path / "protected.json", tmp_path / "r.html"
    protected.touch(mode=0o400)
    given = ("compare", data, "--rig", toml, "--report", report)
    assert run(*given, "--write-rig", "/proc/new.toml", "--json", protected) == 2
    caught = capsys.readouterr()
    assert re.search(
        r"--json \S+: is protected against writing; .*\n.*--write-rig /proc/new.toml: cannot be", caught.err
    )
    assert not caught.out
    assert not report.exists()
    assert run(*given, "--write-rig", "/dev/full", "--json", tmp_path / "c.json") == 2
    caught = capsys.readouterr()
    assert caught.err.splitlines() == [
        "rotorjax: /dev/full: cannot be written (No space left on device); choose another path"
    ]
    assert "Report: " in caught.out
    assert report.exists()
    assert (tmp_path / "c.json").exists()


@pytest.mark.skipif(sys.platform != "linux", reason="needs /dev/full")
@pytest.mark.parametrize("where", [">/dev/full", ">&-"])
def test_standard_output_that_takes_nothing_costs_one_message_and_no_file(tmp_path, where):
    data, toml = write(tmp_path)
    outputs = ("--json", tmp_path / "c.json", "--report", tmp_path / "r.html", "--write-rig", tmp_path / "n.toml")
    for arguments in (("effects",), ("compare", data, "--rig", toml, *outputs)):
        command = [sys.executable, "-m", "rotorjax.cli", *map(str, arguments)]
        called = subprocess.run(
            ["sh", "-c", f'"$@" {where}', "sh", *command], capture_output=True, text=True, check=False
        )
        assert called.returncode == 2
        (line,) = called.stderr.splitlines()
        assert re.match("rotorjax: standard output: (is closed|cannot be written to .*); let it go to", line)
    assert all(path.stat().st_size for path in outputs[1::2])


@pytest.mark.skipif(sys.platform != "linux", reason="needs /dev/full")
@pytest.mark.parametrize("where", ["2>/dev/full", "2>&-"])
def test_standard_error_that_takes_nothing_changes_nothing(where):
    command = [sys.executable, "-m", "rotorjax.cli", "effects"]
    for name, status in (("crack", 0), ("crak", 2)):
        called = subprocess.run(["sh", "-c", f'"$@" {where}', "sh", *command, name], capture_output=True, check=False)
        assert called.returncode == status
        assert bool(called.stdout) == (status == 0)


def test_bad_table_writes_nothing(tmp_path, capsys):
    data, toml = write(tmp_path, table=f"{HEADER}\n{ROWS[0]}\nbaseline,1500,Q,1,1,0,0.3\n")
    outputs = [tmp_path / name for name in ("c.json", "r.html", "n.toml")]
    assert (
        run("compare", data, "--rig", toml, "--json", outputs[0], "--report", outputs[1], "--write-rig", outputs[2])
        == 2
    )
    assert "data.csv:3: column 3 (probe): unknown probe 'Q'" in capsys.readouterr().err
    assert not any(path.exists() for path in outputs)


def test_what_is_declared_uncertain_is_not_added(tmp_path, capsys):
    data, toml = write(tmp_path, rig=RIG + "[uncertainty]\nmass = 0.1\n")
    assert run("compare", data, "--rig", toml, "--effect", "mass_error") == 2
    assert "declares it uncertain" in capsys.readouterr().err


def test_values_given_replace_those_of_the_rig(tmp_path):
    data, toml = write(tmp_path, rig=RIG + "[effects.cross_coupling]\ncross_stiffness_n_per_m = 500.0\n")
    arguments = ("--effect", "cross_coupling:cross_stiffness_n_per_m=800", "--write-rig", tmp_path / "n.toml")
    assert run("compare", data, "--rig", toml, *arguments) == 0
    assert float(read_rig(tmp_path / "n.toml").model.find("cross_coupling").cross_stiffness_n_per_m) == pytest.approx(
        800.0
    )


def test_a_mistake_in_the_rig_file_is_tried_and_put_right(tmp_path):
    from_example = tmp_path / "example"
    assert run("example", from_example) == 0
    rig, table = from_example / "rig.toml", from_example / "measurement.csv"
    right, answer = tmp_path / "right.toml", tmp_path / "a.json"
    rig.write_text(rig.read_text(encoding="utf-8").replace('phase = "lead"', 'phase = "lag"'), encoding="utf-8")
    assert (
        run("compare", table, "--rig", rig, "--effect", "phase_sign_reversed", "--write-rig", right, "--json", answer)
        == 0
    )
    told = json.loads(answer.read_text(encoding="utf-8"))
    assert told["written_down_wrongly"]["name"] == "phase_sign_reversed"
    assert told["before"]["rms_um"] > 100.0
    assert told["rms_um"] < 32.5
    assert 'phase = "lead"' in right.read_text(encoding="utf-8")
    assert run("compare", table, "--rig", right, "--json", answer) == 0
    assert json.loads(answer.read_text(encoding="utf-8"))["rms_um"] == pytest.approx(told["rms_um"], rel=1e-6)


def test_exchanged_runs_are_tried_by_their_names(tmp_path):
    from_example, answer = tmp_path / "example", tmp_path / "a.json"
    assert run("example", from_example) == 0
    rig, table = from_example / "rig.toml", from_example / "measurement.csv"
    lines = table.read_text(encoding="utf-8")
    for one, other in [("trial-a", "here"), ("trial-b", "trial-a"), ("here", "trial-b")]:
        lines = lines.replace(f"{one},", f"{other},")
    table.write_text(lines, encoding="utf-8")
    exchanged = "runs_exchanged:A=trial-a,B=trial-b"
    assert run("compare", table, "--rig", rig, "--effect", exchanged, "--json", answer) == 0
    told = json.loads(answer.read_text(encoding="utf-8"))
    assert told["written_down_wrongly"]["name"] == "runs_exchanged.trial-a.trial-b"
    assert told["before"]["rms_um"] > 50.0
    assert told["rms_um"] == pytest.approx(29.55, abs=0.01)  # with what is declared uncertain fitted


def test_text_from_files_is_escaped(tmp_path):
    name = "<script>alert(1)</script>"
    rig = RIG.replace("[runs.baseline]", f'[runs."{name}"]')
    data, toml = write(tmp_path, rig=rig, table="\n".join([HEADER, *(row.replace("baseline", name) for row in ROWS)]))
    assert run("compare", data, "--rig", toml, "--report", tmp_path / "r.html") == 0
    page = (tmp_path / "r.html").read_text()
    assert "<script>" not in page
    assert "&lt;script&gt;" in page


@pytest.fixture(scope="module")
def explained(example):
    """The whole of `explain` on the example, once."""
    status = run(
        "explain", example / "measurement.csv", "--rig", example / "rig.toml",
        "--json", example / "e.json", "--report", example / "e.html", "--write-rig", example / "explained.toml",
    )  # fmt: skip
    assert status == 0
    return json.loads((example / "e.json").read_text(), parse_constant=lambda name: pytest.fail(f"{name} in JSON"))


def test_explain_finds_what_the_example_hides(explained):
    assert explained["verdict"] == "explained"
    assert explained["effects"] == ["residual_unbalance", "cross_coupling"]
    assert explained["p_value"] > 0.01
    assert [step["added"] for step in explained["steps"]] == [None, "residual_unbalance", "cross_coupling"]
    first, *_, last = explained["steps"]
    assert first["parameters"] == {}
    assert set(first["uncertain_values"]) == {"stiffness_error", "damping_error"}
    assert last["parameters"]["cross_coupling"]["cross_stiffness_n_per_m"]["value"] == pytest.approx(1200.0, abs=35.0)
    assert first["held_out_rms_um"] > 10.0 * last["held_out_rms_um"]
    assert last["reduced_chi2"] == pytest.approx(1.0, abs=0.35)


def test_the_report_begins_with_verdict_and_sizes(explained, example):
    """9 g mm at 50° and 1200 N/m, as magnitude and angle with 95 % intervals, before any table."""
    first = (example / "e.html").read_text().split("<nav")[0]
    assert '<span class="badge explained">explained</span>' in first
    size, angle = re.search(r"<dt>unbalance</dt><dd>([\d.]+) ± [\d.]+ g mm at ([\d.]+) ± [\d.]+°</dd>", first).groups()
    assert float(size) == pytest.approx(9.0, abs=0.1)
    assert float(angle) == pytest.approx(50.0, abs=1.0)
    assert re.search(r"<dt>cross-coupled stiffness</dt><dd>1[12]\d\d ± \d+ N/m</dd>", first)
    assert first.count("<img") == 2
    assert "<table" not in first


def test_explain_json_holds_the_contract(explained):
    keys = {
        "verdict",
        "effects",
        "steps",
        "ranking",
        "ties",
        "detected_but_small",
        "where",
        "next_measurement",
        "noise",
        "run_scatter",
        "p_value",
    }
    assert keys <= set(explained)
    assert explained["ranking"] == explained["steps"][0]["ranking"]
    assert {r["effect"] for r in explained["ranking"]} >= {"none", "residual_unbalance", "thermal_bow"}
    assert sum(r["probability"] for r in explained["ranking"]) == pytest.approx(1.0)
    assert {"effect", "probability", "log_evidence", "reduced_chi2", "converged"} == set(explained["ranking"][0])
    for step in explained["steps"]:
        assert {"added", "rms_um", "reduced_chi2", "held_out_rms_um", "ranking", "ties", "parameters"} <= set(step)
    worst = explained["where"][0]
    assert {"run", "speed_rpm", "probe", "order", "residual_um", "standardised"} <= set(worst)
    assert worst["standardised"] >= explained["where"][1]["standardised"]
    assert 0 < explained["cost"]["linearisations"] < explained["cost"]["limit"]
    assert not explained["cost"]["exhausted"]


def test_explain_json_has_probabilities_of_whole_explanations(explained):
    first, *others = explained["probable"]
    assert sorted(first["effects"]) == sorted(explained["effects"])
    assert 0.9 < first["probability"] == explained["probability"] <= 1.0
    assert all(one["probability"] < first["probability"] for one in others)


def test_explained_model_is_taken_by_compare(example, explained, capsys):
    assert (
        run(
            "compare",
            example / "measurement.csv",
            "--rig",
            example / "explained.toml",
            "--json",
            example / "again.json",
        )
        == 0
    )
    again = json.loads((example / "again.json").read_text())
    assert again["rms_um"] == pytest.approx(explained["steps"][-1]["rms_um"], rel=1e-6)
    assert "within the noise" in capsys.readouterr().out


def test_explain_report_is_one_file_without_network(explained, example):
    page = (example / "e.html").read_text()
    assert "The model lacks residual unbalance and cross-coupled stiffness." in page
    assert "What is missing beside residual unbalance" in page
    assert not re.search(r'(src|href)="http', page)


@pytest.mark.parametrize(
    ("option", "message"),
    [
        (("--only", "cross_copling"), "--only: unknown effect 'cross_copling'; did you mean 'cross_coupling'?"),
        (("--exclude", "runout,magic"), "--exclude: unknown effect 'magic'"),
        (("--max-effects", "-1"), "--max-effects -1: must be zero or more"),
    ],
)
def test_explain_refuses_with_a_cure(example, capsys, option, message):
    assert (
        run(
            "explain",
            example / "measurement.csv",
            "--rig",
            example / "rig.toml",
            *option,
            "--json",
            example / "no.json",
        )
        == 2
    )
    assert message in capsys.readouterr().err
    assert not (example / "no.json").exists()


def test_what_cannot_be_balanced_is_refused_with_a_cure(tmp_path, capsys):
    """An order such as oil whirl has, under a nonlinear force; a model that has no steady state as it was
    declared.
    """
    csv, toml = write(tmp_path)
    odd = csv.read_text(encoding="utf-8")
    last = odd.strip().splitlines()[-1].split(",")
    last[odd.splitlines()[0].split(",").index("order")] = "0.43"
    csv.write_text(odd.rstrip() + "\n" + ",".join(last) + "\n", encoding="utf-8")
    assert run("explain", csv, "--rig", toml, "--json", tmp_path / "no.json") == 2
    assert "they must be multiples of 1, 1/2, 1/3 or 1/4; leave the others out" in capsys.readouterr().err
    csv.write_text(odd.replace(",1500,", ",4500,"), encoding="utf-8")
    toml.write_text(
        toml.read_text(encoding="utf-8") + "\n[effects.clearance]\nstiffness_n_per_m = 1e9\ninverse_gap_per_m = 1e5\n",
        encoding="utf-8",
    )
    for command in (("explain",), ("compare", "--effect", "residual_unbalance")):
        assert run(*command, csv, "--rig", toml, "--json", tmp_path / "no.json") == 2
        assert "no steady state that could be found for" in capsys.readouterr().err
    assert not (tmp_path / "no.json").exists()


def test_simulate_says_what_speaks_against_the_values(tmp_path, capsys):
    """A stop that the weight reaches; a rotor that excites itself; a crack deeper than the shaft; a stop so near that
    no steady state is found.
    """
    _, toml = write(tmp_path)
    toml.write_text(toml.read_text(encoding="utf-8").replace("[rotor]", '[rotor]\ngravity = "-y"', 1), encoding="utf-8")
    common = ("simulate", "--rig", toml, "--speeds", "500:900:3", "--output", tmp_path / "made.csv")
    assert run(*common, "--effect", "clearance:stiffness_n_per_m=2e3,inverse_gap_per_m=1e4") == 0
    assert "the rotor lies in it even at rest" in capsys.readouterr().out
    assert run(*common, "--effect", "cross_coupling:cross_stiffness_n_per_m=1e5") == 0
    assert "unstable: the machine does not stay there" in capsys.readouterr().out
    assert run(*common, "--effect", "crack:loss_x_n_per_m=1e6,loss_y_n_per_m=0.0") == 0
    assert "deeper than the shaft" in capsys.readouterr().out
    _, toml = write(tmp_path)
    (tmp_path / "made.csv").unlink()
    fast = ("simulate", "--rig", toml, "--speeds", "3000:6000:3", "--output", tmp_path / "made.csv")
    assert run(*fast, "--effect", "clearance:stiffness_n_per_m=1e9,inverse_gap_per_m=1e5") == 2
    assert "no steady state that could be found for" in capsys.readouterr().err
    assert not (tmp_path / "made.csv").exists()


def test_terms_of_a_missing_force_are_effects_like_any_other(tmp_path, capsys):
    """What `explain` names can be simulated, added, written to a rig file and read again."""
    _, toml = write(tmp_path)
    table, fitted = tmp_path / "made.csv", tmp_path / "fitted.toml"
    given = ("--speeds", "500:900:5", "--noise-um", "0.1", "--output", table)
    assert run("simulate", "--rig", toml, *given, "--effect", "term_steady_x:force_n=0.5", "--orders", "0,1") == 0
    assert run("compare", table, "--rig", toml, "--effect", "term_steady_x", "--write-rig", fitted) == 0
    assert "term_steady_x" in fitted.read_text(encoding="utf-8")
    assert run("compare", table, "--rig", fitted) == 0
    assert "within the noise" in capsys.readouterr().out
    assert run("effects", "term_steady_x") == 0
