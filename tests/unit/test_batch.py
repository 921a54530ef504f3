"""Many cases: nothing finished is lost, nothing half-written stays, one bad case costs itself only."""

import contextlib
import csv
import itertools
import json
import os
import random
import re
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path

import pytest

from rotorjax.batch.case import Case
from rotorjax.batch.explaining import COLUMNS, Task, explain_case
from rotorjax.batch.overview import by_attention, overview
from rotorjax.batch.pairs import pairs
from rotorjax.batch.pool import Processes
from rotorjax.batch.results import write_results
from rotorjax.batch.runner import Progress, run
from rotorjax.batch.store import Store
from rotorjax.cli import main
from rotorjax.cli.many import progress_text, report_paths
from rotorjax.data.example import write_example
from rotorjax.errors import InputError
from rotorjax.reporting.tables import duration

import batch_cases
from batch_cases import CONFIGURATION, square, troubled

SCRIPT = Path(batch_cases.__file__)


def squares(count: int) -> list[Case]:
    return [Case(f"case {k}", k) for k in range(count)]


def store(folder: Path) -> Store:
    return Store(folder / "rows.sqlite", CONFIGURATION, ("square", "value"))


def alive(process: int) -> bool:
    state = Path(f"/proc/{process}/stat")
    return state.exists() and state.read_text().rpartition(")")[2].split()[0] != "Z"


def gone(processes: Iterable[int], patience_s: float = 10.0) -> bool:
    deadline = time.monotonic() + patience_s
    while any(map(alive, processes)) and time.monotonic() < deadline:
        time.sleep(0.05)
    return not any(map(alive, processes))


def test_a_restart_does_only_what_is_left(tmp_path: Path):
    told: list[Progress] = []
    with store(tmp_path) as kept:
        run(square, squares(3), kept, Processes(2))
    with store(tmp_path) as kept:
        run(square, squares(8), kept, Processes(2), told.append)
        rows = kept.rows()
    assert [row["square"] for row in rows] == [k**2 for k in range(8)]
    assert {row["threads"] for row in rows} == {"1"}
    assert os.getpid() not in {row["process"] for row in rows}
    assert (told[-1].total, told[-1].before, told[-1].done, told[-1].failed, told[-1].left_s) == (8, 3, 5, 0, 0.0)
    assert all(later.done == earlier.done + 1 for earlier, later in itertools.pairwise(told))


def test_changed_cases_are_done_anew_and_gone_ones_not_shown(tmp_path: Path):
    with store(tmp_path) as kept:
        run(square, [Case("a", 1, "first"), Case("b", 2, "first"), Case("c", 3, "first")], kept, Processes(1))
        again = [Case("b", 2, "first"), Case("a", 5, "second")]
        assert [case.name for case in kept.plan(again)] == ["a"]
        run(square, again, kept, Processes(1))
        assert [(row["name"], row["square"]) for row in kept.rows()] == [("b", 4), ("a", 25)]


def test_another_run_and_other_files_are_refused(tmp_path: Path):
    store(tmp_path).close()
    with pytest.raises(InputError, match=r"another run .power is 2 there, 3 here"):
        Store(tmp_path / "rows.sqlite", {**CONFIGURATION, "power": 3})
    other = sqlite3.connect(tmp_path / "other.sqlite")
    other.execute("CREATE TABLE mine (value)")
    other.close()
    with pytest.raises(InputError, match="something else"):
        Store(tmp_path / "other.sqlite", CONFIGURATION)
    (tmp_path / "text.sqlite").write_text("run,speed_rpm\n" * 100)
    with pytest.raises(InputError, match="no SQLite file"):
        Store(tmp_path / "text.sqlite", CONFIGURATION)
    with pytest.raises(InputError, match="cannot be written"):
        Store(tmp_path / "none" / "rows.sqlite", CONFIGURATION)


def test_one_writes_while_others_read(tmp_path: Path):
    with store(tmp_path) as kept:
        run(square, squares(2), kept, Processes(1))
        with pytest.raises(InputError, match="another run is writing"):
            store(tmp_path)
        reader = sqlite3.connect(tmp_path / "rows.sqlite")
        assert reader.execute("SELECT name, square FROM results").fetchall() == [("case 0", 0), ("case 1", 1)]
        reader.close()


def test_trouble_costs_the_case_that_has_it(tmp_path: Path):
    names = ["kills", "well", "kills once", "raises", "not finite", "bad input", "also well"]
    cases = [Case(name, (name, tmp_path)) for name in names]
    told: list[Progress] = []
    with store(tmp_path) as kept:
        run(troubled, cases, kept, Processes(2), told.append)
        rows = {row["name"]: row for row in kept.rows()}
        assert [case.name for case in kept.plan(cases)] == ["kills", "raises", "not finite"]
    assert told[-1].failed == 4
    assert {name for name in names if rows[name]["failure"] is None} == {"well", "kills once", "also well"}
    assert "process died" in rows["kills"]["failure"]
    assert "RuntimeError: nobody foresaw this (batch_cases.py:" in rows["raises"]["failure"]
    assert rows["bad input"]["failure"] == "no rig file"
    begun = {name: (tmp_path / name).stat().st_size for name in names}
    assert begun == {**dict.fromkeys(names, 1), "kills": 2, "kills once": 2}


def started(folder: Path, count: int, function: str) -> subprocess.Popen:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, [SCRIPT.parent, SCRIPT.parents[1]]))}
    command = [sys.executable, str(SCRIPT), str(folder / "rows.sqlite"), str(count), function]
    # Tests that run in the background may ignore Ctrl-C, and what they start would, too.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return subprocess.Popen(
            command, env=environment, stderr=subprocess.PIPE, text=True, start_new_session=True, cwd=folder
        )
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("kills", [4, pytest.param(20, marks=pytest.mark.campaign)])
def test_killed_at_random_moments_loses_nothing_finished(tmp_path: Path, kills: int):
    """Progress is told after a row is kept: what was told is there, whole, and no worker goes on."""
    chance, count, before, workers = random.Random(20260417), 5000, 0, set()
    with store(tmp_path) as kept:
        kept.plan(squares(count))
    for kill in range(kills):
        process = started(tmp_path, count, "slow")
        assert process.stderr is not None
        # Every second one in the midst of the cases, however long a loaded machine takes to come there.
        told = [0]
        while kill % 2 and told[-1] <= before:
            told += _told(process.stderr.readline())
        time.sleep(chance.uniform(0.0, 0.5 if kill % 2 else 1.0))
        process.kill()
        told += [number for line in process.communicate()[1].splitlines() for number in _told(line)]
        reader = sqlite3.connect(tmp_path / "rows.sqlite")
        assert reader.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        reader.close()
        with store(tmp_path) as kept:
            left = kept.plan(squares(count))
            rows = kept.rows()
        before = len(rows)
        assert count - len(left) == before >= max(told)
        assert all(row["square"] == int(row["name"].split()[1]) ** 2 for row in rows)
        workers |= {row["process"] for row in rows}
    assert len(workers) >= kills // 2
    assert gone(workers)
    assert [path.name for path in tmp_path.iterdir() if "journal" not in path.name] == ["rows.sqlite"]


def test_ctrl_c_ends_all_at_once(tmp_path: Path):
    process = started(tmp_path, 4, "announced")
    deadline = time.monotonic() + 120.0
    # A worker that has not been told yet what it is says that nobody is there.
    while len(list(tmp_path.glob("begun *"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    workers = _children(process.pid)
    os.killpg(process.pid, signal.SIGINT)
    said = process.communicate(timeout=20.0)[1]
    assert process.returncode == 130
    assert said.rstrip().endswith("rotorjax: stopped; kept")
    assert "Traceback" not in said
    assert gone(workers)


def test_workers_end_with_what_stops_the_run(tmp_path: Path):
    """A full disk, say: whatever the other worker is at."""

    def stop(progress: Progress) -> None:
        if progress.done:
            raise InputError("disk full")

    began = time.monotonic()
    with store(tmp_path) as kept:
        with pytest.raises(InputError, match="disk full"):
            run(batch_cases.first_or_endless, squares(2), kept, Processes(2), stop)
        assert [row["name"] for row in kept.rows()] == ["case 0"]
    assert time.monotonic() - began < 20.0
    children = _children(os.getpid())
    assert gone([child for child in children if b"spawn_main" in _command(child)])


def _command(process: int) -> bytes:
    """Its command line; nothing of one that has ended."""
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):
        return Path(f"/proc/{process}/cmdline").read_bytes()
    return b""


def _told(line: str) -> list[int]:
    """Cases that a line of progress says are finished; none of a line that is something else (the traceback of a worker
    whose parent was killed while it started), or was cut.
    """
    counts = re.fullmatch(r" *\d+ s  (\d+) (\d+)\s*", line)
    return [sum(map(int, counts.groups()))] if counts else []


def _children(parent: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{parent}/task/{parent}/children").read_text().split()]


def test_progress_in_one_line():
    text = progress_text(Progress(total=200, before=20, done=30, failed=2, left_s=700.0))
    assert "50 of 200, 2 failed, about 12 min left" in text
    assert (text.count("#"), text.count("-")) == (6, 18)
    assert [duration(s) for s in (42.0, 3600.0, 9000.0)] == ["42 s", "60 min", "2.5 h"]


def touch(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(f"# {name}")


def test_tables_of_a_folder_find_their_rig_file(tmp_path: Path):
    touch(
        tmp_path, "a.csv", "a.toml", "b.CSV", "rig.toml", "deep/er/c.csv", "deep/rig.toml", ".hidden.csv", "notes.txt"
    )
    touch(tmp_path, "results.csv", "reports/old.csv")
    found = pairs(tmp_path, [tmp_path / "results.csv", tmp_path / "reports"])
    rigs = {pair.name: pair.rig and pair.rig.relative_to(tmp_path).as_posix() for pair in found}
    assert rigs == {"a.csv": "a.toml", "b.CSV": "rig.toml", "deep/er/c.csv": None}
    before = {pair.name: pair.digest for pair in found}
    (tmp_path / "rig.toml").write_text("# changed")
    assert [name for name, digest in before.items() if digest != {p.name: p.digest for p in found}[name]] == ["b.CSV"]
    with pytest.raises(InputError, match="no table in it"):
        pairs(tmp_path / "deep", [tmp_path / "deep" / "er"])


def test_a_list_names_tables_and_rig_files(tmp_path: Path):
    path = tmp_path / "list.csv"
    path.write_text("\ufeffrig;data;name\nr.toml;a.csv;\nr2.toml; a.csv ;other\n;;\n")
    assert [(p.name, p.data, p.rig) for p in pairs(path)] == [
        ("a.csv", tmp_path / "a.csv", tmp_path / "r.toml"),
        ("other", tmp_path / "a.csv", tmp_path / "r2.toml"),
    ]
    for text, problem in (
        ("data,rigs\na,b\n", "column 'rig' is missing"),
        ("data,rig\na.csv,\n", ":2: column 'rig' is empty"),
        ("data,rig\na.csv,r\na.csv,q\n", "listed 2 times"),
        ("data,rig\n", "no rows"),
        ("", "empty"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=problem):
            pairs(path)

    path.write_text("data,rig\ra.csv,a.toml\rb.csv,b.toml\r")
    assert [p.name for p in pairs(path)] == ["a.csv", "b.csv"]
    path.write_text(f"data,rig\n{'a' * 200_000},r\n")
    with pytest.raises(InputError, match=r":2: field larger"):
        pairs(path)


RECORDED = '[recordings."records/a.csv"]\nrun = "baseline"\n'


def test_a_rig_file_with_recordings_is_a_case_of_its_own(tmp_path: Path):
    files = {"plain/a.csv": "", "plain/a.toml": RECORDED, "other/rig.toml": RECORDED, "other/records/a.csv": "1,2\n"}
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    found = pairs(tmp_path)
    assert [(p.name, p.data, p.rig) for p in found] == [
        ("plain/a.csv", tmp_path / "plain/a.csv", tmp_path / "plain/a.toml"),
        ("other/rig.toml", None, tmp_path / "other/rig.toml"),
    ]
    before = found[1].digest
    (tmp_path / "other/records/a.csv").write_text("1,3\n")
    assert found[1].digest != before


def test_the_slow_roll_is_a_recording_too(tmp_path: Path):
    (tmp_path / "rig.toml").write_bytes(b"\xef\xbb\xbf[waveform]\nslow_roll = 'slow.csv'\n" + RECORDED.encode())
    touch(tmp_path, "slow.csv", "records/a.csv")
    found = pairs(tmp_path)
    assert [p.name for p in found] == ["rig.toml"]
    before = found[0].digest
    (tmp_path / "slow.csv").write_text("1,3\n")
    assert found[0].digest != before


def test_a_list_may_name_a_rig_file_with_recordings_alone(tmp_path: Path):
    (tmp_path / "a.toml").write_text(RECORDED)
    (tmp_path / "list.csv").write_text("data,rig\n,a.toml\n")
    assert [(p.name, p.data, p.rig) for p in pairs(tmp_path / "list.csv")] == [("a.toml", None, tmp_path / "a.toml")]


@pytest.mark.parametrize("text", ["a = 1" + "0" * 5000, "a = " + "[" * 3000, "a" + ".a" * 3000 + " = 1"])
def test_a_rig_file_that_cannot_be_read_is_a_case_of_its_own(tmp_path: Path, text: str):
    (tmp_path / "a.toml").write_text(text)
    (tmp_path / "b.toml").write_text('[recordings."a\\u0000b"]\n')
    found = pairs(tmp_path)
    assert [pair.name for pair in found] == ["a.toml", "b.toml"]
    assert all(pair.digest for pair in found)
    assert str(tmp_path / "a.toml") in explain_case(Task(None, found[0].rig))["failure"]


def test_recordings_are_explained_as_one_case_of_many(tmp_path: Path):
    write_example(tmp_path, recordings=True)
    row = explain_case(Task(None, tmp_path / "rig.toml", only=("residual_unbalance",), max_effects=1))
    assert "failure" not in row
    assert row["data"] is None
    assert row["effects"] == ["residual_unbalance"]


def test_reports_stay_in_their_folder_and_apart():
    names = ["a.csv", "../../etc/passwd", "/abs/b.csv", "..\\c.csv", "x<y>.csv", "x?y>.csv", "A.csv", ".."]
    paths = report_paths(names)
    assert len({path.lower() for path in paths.values()}) == len(names)
    assert all(not Path(path).is_absolute() and ".." not in Path(path).parts for path in paths.values())
    assert paths["/abs/b.csv"] == "abs/b.csv.html"
    assert report_paths(["a.csv"]) == {"a.csv": "a.csv.html"}


def row(name: str, verdict: str | None, before: float | None = None, **others) -> dict:
    kinds = {key: [] if kind == "names" or isinstance(kind, dict) else None for key, kind in COLUMNS.items()}
    return {**kinds, "name": name, "verdict": verdict, "error_before_um": before, **others}


HOSTILE = '<script>alert("1")</script>&\x1b[2J'


def test_the_overview_begins_with_what_needs_attention_and_escapes_names(tmp_path: Path):
    rows = [
        row("calm", "nothing missing", 50.0),
        row("small", "explained", 1.0),
        row("large", "explained", 9.0),
        row("open", "undecided", 2.0, ties=["crack or rub"], next_measurement="baseline at 1850 rpm"),
        row("strange", "unexplained", 3.0, missing_force=["a stiff force"]),
        row(HOSTILE, None, failure=f"{HOSTILE}: bad\nsecond line"),
    ]
    assert [r["name"] for r in by_attention(rows)] == [HOSTILE, "strange", "open", "large", "small", "calm"]
    rows[1] |= {"report": str(tmp_path / "reports" / "a b%<.html"), "effects": [HOSTILE], "balance_in_words": [HOSTILE]}
    page = overview(rows, title=HOSTILE, folder=tmp_path)
    assert "<script" not in page
    assert "\x1b" not in page
    assert page.count("&lt;script&gt;") == 6
    assert 'href="reports/a%20b%25%3C.html"' in page
    assert "measure next: baseline at 1850 rpm" in page
    assert "crack or rub" in page
    assert "http" not in page


def test_results_as_csv_and_parquet(tmp_path: Path):
    rows = [
        row("a", "explained", 2.5, effects=["crack"], sizes=[{"effect": "crack", "parameter": "k", "value": 1.0}]),
        {"name": "b", "failure": "two\nlines", "seconds": 0.5},
    ]
    write_results(tmp_path / "r.csv", rows, COLUMNS)
    with (tmp_path / "r.csv").open(newline="") as file:
        read = list(csv.DictReader(file))
    assert list(read[0]) == list(COLUMNS)
    assert (read[0]["error_before_um"], json.loads(read[0]["effects"]), read[1]["failure"]) == (
        "2.5",
        ["crack"],
        "two\nlines",
    )
    parquet = pytest.importorskip("pyarrow.parquet")
    write_results(tmp_path / "r.parquet", rows, COLUMNS)
    read = parquet.read_table(tmp_path / "r.parquet").to_pylist()
    assert list(read[0]) == list(COLUMNS)
    assert (read[0]["effects"], read[0]["sizes"][0]["value"], read[1]["sizes"]) == (["crack"], 1.0, None)


def many(*arguments) -> int:
    return main(["explain-many", *map(str, arguments)])


def test_two_machines_and_a_bad_file(tmp_path: Path, capsys):
    """The shipped example twice, once with a rig file of its own, beside a table that cannot be read."""
    fleet, output, page = tmp_path / "fleet", tmp_path / "r.sqlite", tmp_path / "r.html"
    assert main(["example", str(fleet)]) == 0
    (fleet / "own.csv").write_text((fleet / "measurement.csv").read_text())
    (fleet / "own.toml").write_text((fleet / "rig.toml").read_text())
    (fleet / "bad.csv").write_text("run,speed_rpm,probe,order,amplitude_um,phase_deg\nbaseline,-5,X,1,2.0,30\n")
    capsys.readouterr()
    options = ["--output", output, "--workers", 2, "--only", "residual_unbalance,cross_coupling,residual_bow"]
    assert many(fleet, *options, "--report", page, "--reports", tmp_path / "reports") == 0
    told = capsys.readouterr().out
    assert "3 cases" in told
    assert "1 failed, 2 explained" in told
    connection = sqlite3.connect(output)
    found = {
        name: (verdict, json.loads(effects or "[]"), before, failure)
        for name, verdict, effects, before, failure in connection.execute(
            "SELECT name, verdict, effects, error_before_um, failure FROM results"
        )
    }
    likely = dict(connection.execute("SELECT name, probability FROM results"))
    sets = json.loads(*connection.execute("SELECT probable FROM results WHERE name = 'own.csv'").fetchone())
    connection.close()
    assert likely["bad.csv"] is None
    assert sets[0] == {"effects": "cross_coupling + residual_unbalance", "probability": likely["own.csv"]}
    assert 0.95 < sum(one["probability"] for one in sets) <= 1.0
    right = ("explained", ["residual_unbalance", "cross_coupling"], pytest.approx(32.49, abs=0.01), None)
    assert found["measurement.csv"] == found["own.csv"] == right
    assert main(["explain", str(fleet / "bad.csv"), "--rig", str(fleet / "rig.toml")]) == 2
    assert f"rotorjax: {found['bad.csv'][3]}" in capsys.readouterr().err
    assert page.read_text().index("bad.csv") < page.read_text().index('href="reports/own.csv.html"')
    assert (tmp_path / "reports" / "own.csv.html").stat().st_size > 10_000
    assert many(fleet, *options) == 2  # without reports it is another run
    assert "reports is" in capsys.readouterr().err


def test_odd_files_are_rows(tmp_path: Path, capsys):
    """Names that are no text, files that are no tables, lists of files that are not there."""
    fleet, output = tmp_path / "fleet", tmp_path / "r.csv"
    touch(fleet, "rig.toml", "esc\x1b[2J.csv", "folder.csv/deep.csv")
    Path(os.fsdecode(bytes(fleet) + b"/\xff.csv")).write_bytes(b"\0\1\2")
    assert many(fleet, "--output", output, "--report", tmp_path / "r.html", "--workers", 1) == 0
    assert "3 failed" in capsys.readouterr().out
    with output.open(newline="", encoding="utf-8") as file:
        failures = {row["name"]: row["failure"] for row in csv.DictReader(file)}
    assert list(failures) == ["esc\\x1b[2J.csv", "folder.csv/deep.csv", "\\udcff.csv"]
    assert "rig.toml" in failures["esc\\x1b[2J.csv"]
    assert "no rig file" in failures["folder.csv/deep.csv"]
    listed = tmp_path / "list.csv"
    listed.write_text("data,rig\nnone.csv,none.toml\n")
    assert many(listed, "--output", tmp_path / "l.sqlite", "--workers", 1) == 0
    assert "give the path of a readable file" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["--output", "{0}/r.txt"], "ends in .parquet, .sqlite or .csv"),
        (["--output", "{0}/a.csv"], "exists already"),
        (["--output", "{0}/none/r.csv"], "does not exist"),
        (["--output", "{0}/r.csv", "--report", "{0}/r.csv"], "is written by the same command"),
        (["--output", "{0}/r.csv", "--report", "{0}/b.csv"], "ends in .html"),
        (["--output", "{0}/r.csv", "--reports", "{0}/a.csv"], "name a folder"),
        (["--output", "{0}/r.csv", "--workers", "0"], "one or more"),
        (["--output", "{0}/r.csv", "--workers", "2", "--cluster", "tcp://x:1"], "the cluster's workers"),
        (["--output", "{0}/r.csv", "--only", "crak"], "crack"),
    ],
)
def test_bad_arguments(tmp_path: Path, capsys, arguments, problem):
    touch(tmp_path, "a.csv", "a.toml")
    assert many(tmp_path, *(argument.format(tmp_path) for argument in arguments)) == 2
    assert problem in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv", "a.toml"]


def test_the_same_on_a_cluster_of_two_workers(tmp_path: Path):
    distributed = pytest.importorskip("distributed")
    import dask

    from rotorjax.batch.cluster import Cluster

    names = ["well", "kills", "raises", "also well"]
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 1}),
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster,
        store(tmp_path) as kept,
    ):
        executor = Cluster(cluster.scheduler_address)
        assert executor.workers == 2
        run(troubled, [Case(name, (name, tmp_path)) for name in names], kept, executor)
        rows = {row["name"]: row for row in kept.rows()}
    assert {name for name in names if rows[name]["failure"] is None} == {"well", "also well"}
    assert "died" in rows["kills"]["failure"]
    assert "nobody foresaw this" in rows["raises"]["failure"]


def test_a_cluster_that_does_not_answer(monkeypatch):
    pytest.importorskip("distributed")
    from rotorjax.batch import cluster

    monkeypatch.setattr(cluster, "ANSWER_S", 0.5)
    with pytest.raises(InputError, match="no scheduler answers"):
        cluster.Cluster("tcp://127.0.0.1:1")
