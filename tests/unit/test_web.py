"""The page to drop files on: what it takes and refuses, one at a time, nothing kept, no one else answered."""

import contextlib
import http.client
import importlib.util
import json
import os
import signal
import subprocess
import sys
import threading
import time
import tomllib
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import uvicorn

import rotorjax
from rotorjax.cli import main
from rotorjax.data.example import FILES, write_example
from rotorjax.data.record_vectors import read_recordings
from rotorjax.data.rig import read_rig
from rotorjax.errors import InputError
from rotorjax.web import guard, worker
from rotorjax.web.jobs import RESULTS
from rotorjax.web.server import configuration, listen
from rotorjax.web.uploads import Limits, TooLargeError, Upload, place_for, shown_name, sorted_out

import web_worker
from browser import Browser, chromium

EXAMPLE = {name: (files("rotorjax") / "data" / "example" / name).read_bytes() for name in FILES}
RIG = EXAMPLE["rig.toml"]
SMALL = Limits(table=20_000, recordings=50_000, rig=10_000)
FAKE = [sys.executable, web_worker.__file__]
REAL = "from rotorjax.web.worker import main; main({'only': ['residual_unbalance'], 'thorough': False})"
SOON = 60.0
"""Seconds."""


class Answer(NamedTuple):
    status: int
    headers: http.client.HTTPMessage
    body: bytes

    @property
    def content(self) -> dict:
        return json.loads(self.body)


class Site(NamedTuple):
    """A server of this process, asked as the page asks."""

    port: int
    folder: Path

    def ask(self, method: str, path: str, body: bytes | None = None, **headers: str | None) -> Answer:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60.0)
        given = {"Host": f"127.0.0.1:{self.port}", "Origin": f"http://127.0.0.1:{self.port}"}
        given |= {name.replace("_", "-"): value for name, value in headers.items()}
        connection.request(method, path, body, {name: value for name, value in given.items() if value is not None})
        answer = connection.getresponse()
        with contextlib.closing(connection):
            return Answer(answer.status, answer.headers, answer.read())

    def explain(self, uploads: dict[str, bytes]) -> Answer:
        content_type, body = form(uploads)
        return self.ask("POST", "/explain", body, Content_Type=content_type)

    def ended(self, within: float = SOON) -> dict:
        end = time.monotonic() + within
        while (job := self.ask("GET", "/job").content)["state"] == "running":
            assert time.monotonic() < end, job
            time.sleep(0.02)
        return job

    def kept(self) -> list[str]:
        """Names of all files in the folder of the server."""
        return sorted(path.name for path in self.folder.rglob("*") if path.is_file())


def form(uploads: dict[str, bytes]) -> tuple[str, bytes]:
    """Files as a browser sends them."""
    parts = [
        b'--limit\r\nContent-Disposition: form-data; name="files"; filename="%b"\r\n\r\n%b\r\n'
        % (name.encode(), content)
        for name, content in uploads.items()
    ]
    return "multipart/form-data; boundary=limit", b"".join([*parts, b"--limit--\r\n"])


@contextlib.contextmanager
def served(folder: Path, command: list[str], limits: Limits = SMALL) -> Iterator[Site]:
    with contextlib.closing(listen(0)) as listening, pytest.MonkeyPatch.context() as patch:
        patch.setattr("tempfile.tempdir", str(folder))
        port = listening.getsockname()[1]
        server = uvicorn.Server(configuration(port, limits, command))
        (root,) = folder.glob("rotorjax-serve-*")
        thread = threading.Thread(target=server.run, args=([listening],))
        thread.start()
        try:
            yield Site(port, root)
        finally:
            server.should_exit = True
            thread.join()
    assert not root.exists()


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Iterator[Site]:
    with served(tmp_path_factory.mktemp("fake"), FAKE) as one:
        yield one


def test_the_example_explained(tmp_path, capsys):
    """By the process that explains in earnest; then a table that is refused as `rotorjax explain` refuses it."""
    bad = b"run,speed_rpm,probe,order,amplitude_um,phase_deg\nbaseline,-5,X,1,2.0,30\ntrial-c,900,X,1,2.0,30\n"
    (tmp_path / "bad.csv").write_bytes(bad)
    (tmp_path / "rig.toml").write_bytes(RIG)
    with served(tmp_path, [sys.executable, "-c", REAL]) as site:
        begun = site.ask("POST", "/example")
        assert begun.status == 202
        job = site.ended(300.0)
        assert (job["state"], job["problems"], job["files"]) == ("done", [], ["rig.toml", "measurement.csv"])
        assert job["sentence"].startswith(("The model lacks residual unbalance", "Unexplained", "Undecided"))
        assert job["stages"][0]["stage"] == "reading measurement.csv"
        assert any(stage["stage"].startswith("what is missing beside") for stage in job["stages"])
        assert 0 < job["spent"] < job["limit"]
        assert site.kept() == sorted(RESULTS)
        report, rig, numbers = (site.ask("GET", f"/jobs/{job['id']}/{name}") for name in RESULTS)
        assert "<h1>measurement.csv: what rig.toml lacks</h1>" in report.body.decode()
        assert report.headers["Content-Security-Policy"] == guard.REPORT
        assert "residual_unbalance" in tomllib.loads(rig.body.decode())["effects"]
        assert numbers.content["verdict"] == job["verdict"]
        assert str(site.folder) not in (report.body + rig.body + numbers.body).decode()
        site.explain({"rig.toml": RIG, "bad.csv": bad})
        refused = site.ended()
        assert refused["state"] == "refused"
        assert main(["explain", str(tmp_path / "bad.csv"), "--rig", str(tmp_path / "rig.toml")]) == 2
        told = capsys.readouterr().err.replace(f"{tmp_path}/", "")
        assert "".join(f"rotorjax: {line}\n" for line in refused["problems"]) in told
        assert site.kept() == []
        assert site.ask("GET", f"/jobs/{job['id']}/{RESULTS[0]}").status == 404


def test_what_is_given_and_what_comes_back(site):
    begun = site.explain({"../../rig.toml": RIG, "C:\\data\\..\\<b>t\u202e.csv": b"well"})
    assert begun.status == 202
    job = site.ended()
    assert job["files"] == ["rig.toml", "<b>t\\u202e.csv"]
    assert job["stages"][0]["stage"] == "reading <b>t\\u202e.csv"
    assert (job["spent"], job["limit"], job["verdict"]) == (12345, 700000, "nothing missing")
    assert job["notes"] == ["rig.toml: a note"]
    assert site.kept() == sorted(RESULTS)
    for name in RESULTS:
        assert f"<title>{name}</title>" in site.ask("GET", f"/jobs/{job['id']}/{name}").body.decode()
    for path in ("/jobs/none/report.html", f"/jobs/{job['id']}/..%2fx", "/nothing", "/..%2f..%2fapp.py", "/page.html"):
        assert site.ask("GET", path).status == 404


@pytest.mark.parametrize(
    ("what", "state", "problems"),
    [
        ("bad", "refused", ["t.csv:2: column 2 (speed_rpm): -5 must be above 0", "rig.toml: no run 'a'"]),
        ("dies", "broken", ["the process that explains has died (killed, or out of memory); try again"]),
        ("raises", "broken", ["RuntimeError: nobody foresaw t.csv"]),
    ],
)
def test_what_does_not_come_to_an_end(site, what, state, problems):
    site.explain({"rig.toml": RIG, "t.csv": what.encode()})
    job = site.ended()
    assert job["state"] == state
    assert [told for told, wanted in zip(job["problems"], problems, strict=True) if told.endswith(wanted)]
    assert site.kept() == []
    assert site.explain({"rig.toml": RIG, "t.csv": b"well"}).status == 202
    assert site.ended()["state"] == "done"


def test_one_at_a_time_and_cancelled_at_once(site):
    site.explain({"rig.toml": RIG, "t.csv": b"endless"})
    for again in (site.explain({"rig.toml": RIG, "t.csv": b"well"}), site.ask("POST", "/example")):
        assert again.status == 409
        assert again.content["problems"][0].startswith("busy")
    began = time.monotonic()
    assert site.ask("POST", "/cancel").content["state"] == "cancelled"
    assert time.monotonic() - began < SOON
    assert site.kept() == []
    assert site.ask("POST", "/cancel").content["state"] == "cancelled"
    site.explain({"rig.toml": RIG, "t.csv": b"well"})
    assert site.ended()["state"] == "done"


def test_cancelled_the_moment_it_is_begun(site):
    """While its process is being begun, too."""
    for _ in range(5):
        assert site.explain({"rig.toml": RIG, "t.csv": b"endless"}).status == 202
        threads = [threading.Thread(target=site.ask, args=("POST", "/cancel")) for _ in range(3)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(SOON)
        assert site.ended()["state"] == "cancelled"
        assert site.kept() == []


def test_results_stay_until_others_begin(site):
    site.explain({"rig.toml": RIG, "t.csv": b"well"})
    job = site.ended()
    for refused in ({"rig.toml": RIG}, {"t.csv": b"well"}, {"rig.toml": RIG, "t.csv": b"x" * 20_001}):
        assert site.explain(refused).status in (400, 413)
    assert site.ask("GET", f"/jobs/{job['id']}/report.html").status == 200
    assert site.kept() == sorted(RESULTS)


def test_what_is_too_large_is_refused(site):
    large = site.explain({"rig.toml": RIG, "t.csv": b"x" * 20_001})
    assert large.status == 413
    assert large.content["problems"][0].startswith("t.csv: 20,001 bytes; a table has at most 20,000 bytes")
    assert site.explain({"rig.toml": b"#" * 10_001, "t.csv": b"x"}).status == 413
    # Before anything is read, and as soon as it is too much where that was not said.
    unsaid = site.ask("POST", "/explain", b"x", Content_Length="2000000", Content_Type=form({})[0])
    assert unsaid.status == 413
    connection = http.client.HTTPConnection("127.0.0.1", site.port, timeout=60.0)
    content_type, body = form({"t.csv": b"x" * 1_200_000})
    headers = {"Origin": f"http://127.0.0.1:{site.port}", "Content-Type": content_type}
    pieces = (body[k : k + 100_000] for k in range(0, len(body), 100_000))
    connection.request("POST", "/explain", pieces, headers, encode_chunked=True)
    with contextlib.closing(connection):
        assert connection.getresponse().status == 413
    assert site.explain({"rig.toml": RIG, "t.csv": b"well"}).status == 202
    site.ended()


@pytest.mark.parametrize(
    ("body", "content_type"),
    [(b"text", "text/plain"), (b"--limit\r\nnothing", form({})[0]), (b"files=x", "application/x-www-form-urlencoded")],
)
def test_what_is_no_form_of_files(site, body, content_type):
    answer = site.ask("POST", "/explain", body, Content_Type=content_type)
    assert answer.status == 400
    assert len(answer.content["problems"]) == 1


def test_nobody_else_is_answered(site):
    here = f"127.0.0.1:{site.port}"
    for host in ("evil.example", f"evil.example:{site.port}", "127.0.0.1", f"127.0.0.1:{site.port + 1}", ""):
        assert site.ask("GET", "/", Host=host, Origin=None).status == 403
    for origin in ("http://evil.example", "null", f"https://{here}", f"http://localhost:{site.port}", None):
        for path in ("/example", "/explain", "/cancel"):
            assert site.ask("POST", path, Origin=origin).status == 403
    assert site.ask("GET", "/job", Origin="http://evil.example").status == 403
    local = f"localhost:{site.port}"
    assert site.ask("POST", "/cancel", Host=local, Origin=f"http://{local}").status == 200
    page = site.ask("GET", "/", Origin=None)
    assert page.status == 200
    assert page.headers["Content-Security-Policy"] == guard.PAGE
    assert page.headers["X-Content-Type-Options"] == "nosniff"
    assert "Access-Control-Allow-Origin" not in page.headers


# What is what


def stored(folder: Path, uploads: dict[str, bytes]) -> list[Upload]:
    kept = []
    for name, content in uploads.items():
        path = place_for(folder, name)
        path.write_bytes(content)
        kept.append(Upload(shown_name(name), path, len(content)))
    return kept


RECORDED = RIG + b'[recordings."a/x.csv"]\nrun = "baseline"\n[recordings."../y.wav"]\nrun = "baseline"\n'


def test_recordings_are_found_by_the_last_part_of_their_names(tmp_path):
    given = sorted_out(stored(tmp_path, {"r.toml": RECORDED, "y.wav": b"y", "x.csv": b"x"}), SMALL)
    assert given.table is None
    assert {name: upload.name for name, upload in given.recordings.items()} == {"a/x.csv": "x.csv", "../y.wav": "y.wav"}
    assert all(upload.path.parent == tmp_path for upload in given.recordings.values())
    assert given.title == "r.toml: what the model lacks"
    # The same rig file may stand beside a table.
    table = sorted_out(stored(tmp_path, {"r.toml": RECORDED, "t.csv": b"t"}), SMALL).table
    assert table is not None
    assert table.name == "t.csv"


def test_the_healthy_table_is_the_one_that_the_rig_file_names(tmp_path):
    named = RIG + b'[model]\nhealthy = "old/h.csv"\n'
    given = sorted_out(stored(tmp_path, {"r.toml": named, "h.csv": b"h", "t.csv": b"t"}), SMALL)
    assert given.table is not None
    assert given.healthy is not None
    assert (given.table.name, given.healthy.name) == ("t.csv", "h.csv")
    assert set(given.shown.values()) == {"r.toml", "t.csv", "h.csv"}
    # By itself it is what is looked at.
    alone = sorted_out(stored(tmp_path, {"r.toml": named, "h.csv": b"h"}), SMALL)
    assert alone.table is not None
    assert (alone.table.name, alone.healthy) == ("h.csv", None)
    with pytest.raises(TooLargeError, match=r"h\.csv: 30,000 bytes"):
        sorted_out(stored(tmp_path, {"r.toml": named, "h.csv": b"h" * 30_000, "t.csv": b"t"}), SMALL)


@pytest.mark.parametrize(
    ("uploads", "problem"),
    [
        ({"t.csv": b""}, "no rig file was given"),
        ({"a.toml": RIG, "b.toml": RIG}, "2 rig files were given"),
        ({"r.toml": RIG}, "only r.toml was given"),
        ({"r.toml": RIG, "a.csv": b"", "b.csv": b""}, "2 files are beside r.toml"),
        ({"r.toml": b"[[[", "a.csv": b"", "b.csv": b""}, "2 files are beside r.toml"),
        ({"r.toml": b"a" + b".a" * 3000 + b" = 1", "a.csv": b"", "b.csv": b""}, "2 files are beside r.toml"),
        ({"r.toml": RIG, "a/t.csv": b"", "b/t.csv": b""}, "t.csv: two files have this name"),
        ({"r.toml": RECORDED, "x.csv": b""}, "names y.wav, not given"),
        ({"r.toml": RECORDED, "z.wav": b""}, "z.wav: not named under"),
        ({"r.toml": RECORDED, "x.csv": b"", "y.wav": b"", "z.csv": b""}, "z.csv: not named under"),
        ({"r.toml": RECORDED + b'[recordings."x.csv"]\n', "x.csv": b"", "y.wav": b""}, "two files called x.csv"),
    ],
)
def test_what_cannot_be_told_is_refused(tmp_path, uploads, problem):
    with pytest.raises(InputError, match=problem):
        sorted_out(stored(tmp_path, uploads), SMALL)


def test_recordings_may_be_larger_than_a_table_but_not_endless(tmp_path):
    assert sorted_out(stored(tmp_path, {"r.toml": RECORDED, "x.csv": b"x" * 30_000, "y.wav": b"y"}), SMALL).recordings
    with pytest.raises(TooLargeError, match="recordings 50,000 bytes together"):
        sorted_out(stored(tmp_path, {"r.toml": RECORDED, "x.csv": b"x" * 30_000, "y.wav": b"y" * 30_000}), SMALL)


@pytest.mark.parametrize("name", ["../../x.csv", "/etc/x.csv", "..\\x.csv", "C:\\x.csv", "a/./x.csv"])
def test_names_are_no_paths(tmp_path, name):
    assert shown_name(name) == "x.csv"
    place = place_for(tmp_path, name)
    assert place.parent == tmp_path
    assert "x" not in place.stem
    assert shown_name("../..") == ".."
    assert place_for(tmp_path, "..").suffix == place_for(tmp_path, "x.py").suffix == ""
    assert shown_name("") == shown_name("/") == "file without a name"


def test_recordings_are_read_from_where_they_are_stored(tmp_path):
    """And from nowhere else, whatever paths the rig file names."""
    demo, kept, told = tmp_path / "demo", tmp_path / "kept", []
    write_example(demo, recordings=True)
    kept.mkdir()
    text = (demo / "rig.toml").read_text()
    named = sorted(path.name for path in (demo / "recordings").iterdir())[:2]
    head = text.partition("[recordings.")[0]
    text = head + "".join(f'[recordings."/outside/{name}"]\nrun = "{name.rpartition("-")[0]}"\n' for name in named)
    uploads = {"rig.toml": text.encode(), **{name: (demo / "recordings" / name).read_bytes() for name in named}}
    given = sorted_out(stored(kept, uploads), Limits())
    job = {
        "rig": str(given.rig.path),
        "table": None,
        "recordings": {name: str(upload.path) for name, upload in given.recordings.items()},
    }
    _, measurement = worker._read(job, told.append)
    directly = read_recordings(read_rig(demo / "rig.toml"), [demo / "recordings" / name for name in named])
    np.testing.assert_allclose(measurement.vectors, directly.measurement(read_rig(demo / "rig.toml")).vectors)
    assert len(told) == 2


# The command


@contextlib.contextmanager
def command(folder: Path, *arguments: str) -> Iterator[tuple[subprocess.Popen, str]]:
    """`rotorjax serve` and its address."""
    source = str(Path(rotorjax.__file__).parents[1])
    with subprocess.Popen(
        [sys.executable, "-m", "rotorjax.cli", "serve", "--port", "0", *arguments],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "TMPDIR": str(folder), "PYTHONPATH": source},
    ) as process:  # fmt: skip
        assert process.stdout is not None
        try:
            yield process, process.stdout.readline()
        finally:
            process.kill()


def test_ctrl_c_ends_it_and_leaves_nothing(tmp_path):
    with command(tmp_path) as (process, told):
        address = told.split()[0]
        port = int(address.rpartition(":")[2].strip("/"))
        assert address == f"http://127.0.0.1:{port}/"
        (root,) = tmp_path.glob("rotorjax-serve-*")
        assert Site(port, root).ask("POST", "/example").status == 202
        assert len(list(root.rglob("*.csv"))) == 1
        assert main(["serve", "--port", str(port)]) == 2
        process.send_signal(signal.SIGINT)
        assert process.wait(SOON) == 130
        assert process.stderr is not None
        assert process.stderr.read() == "rotorjax: stopped\n"
        assert list(tmp_path.iterdir()) == []


def test_a_server_that_is_killed_leaves_nothing_either(tmp_path):
    with command(tmp_path) as (process, told):
        port = int(told.split()[0].rpartition(":")[2].strip("/"))
        assert Site(port, tmp_path).ask("POST", "/example").status == 202
        process.kill()
        end = time.monotonic() + SOON
        while list(tmp_path.iterdir()):
            assert time.monotonic() < end
            time.sleep(0.05)


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["--port", "70000"], "--port 70000: must be 1 to 65535"),
        (["--max-table-mb", "0"], "--max-table-mb 0.0: must be a number above zero"),
        (["--max-table-mb", "1e308"], "--max-table-mb 1e+308: must be a number above zero, at most 1e+09"),
        (["--max-recordings-mb", "nan"], "--max-recordings-mb nan: must be"),
    ],
)
def test_bad_arguments(capsys, arguments, problem):
    assert main(["serve", *arguments]) == 2
    assert problem in capsys.readouterr().err


def test_a_port_that_is_taken(capsys):
    with contextlib.closing(listen(0)) as taken:
        port = taken.getsockname()[1]
        assert main(["serve", "--port", str(port)]) == 2
    assert f"--port {port}: another program has it" in capsys.readouterr().err


def test_without_the_extra(capsys, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert main(["serve"]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "pip install 'rotorjax[web]'" in told


# In a browser

HOSTILE = "<img src=x onerror=alert(1)>.csv"
UNNAMED = "e => !(e.textContent || e.title || (e.labels && e.labels.length))"
"""What can be operated and has no name that is read out."""


@pytest.mark.skipif(chromium() is None, reason="no Chromium on the path")
def test_the_page_in_a_browser(site, tmp_path):
    paths = {name: tmp_path / name for name in ("rig.toml", HOSTILE, "bad.csv", "endless.csv")}
    for name, content in zip(paths, (RIG, b"well", b"bad", b"endless"), strict=True):
        paths[name].write_bytes(content)
    with Browser(tmp_path / "profile") as browser:

        def press(button: str) -> None:
            browser.wait(f"!({button}).disabled")
            browser.value(f"({button}).click(), 1")

        explain = "document.getElementById('explain')"
        browser.open(f"http://127.0.0.1:{site.port}/")
        browser.wait("!document.getElementById('example').disabled")
        browser.drop(300, 200, [paths["rig.toml"], paths["endless.csv"]])
        browser.wait("document.querySelectorAll('#chosen li').length == 2")
        press(explain)
        browser.wait("document.getElementById('stage').innerText.startsWith('what is missing beside')")
        assert "12,345 of 700,000 linearisations" in browser.value("document.getElementById('spent').innerText")
        press("document.getElementById('cancel')")
        browser.wait("document.getElementById('problems').innerText == 'Cancelled; nothing was kept.'")
        press("document.querySelectorAll('#chosen button')[1]")
        browser.drop(300, 200, [paths["bad.csv"]])
        press(explain)
        browser.wait("document.getElementById('problems').innerText.startsWith('bad.csv:2: column 2')")
        press("document.querySelectorAll('#chosen button')[1]")
        browser.drop(300, 200, [paths[HOSTILE]])
        press(explain)
        report = "document.getElementById('report').contentDocument"
        browser.wait(f"!document.getElementById('result').hidden && {report}.body?.innerText == 'of well'")
        assert browser.value("document.getElementById('verdict').innerText") == "nothing missing"
        assert browser.value("[...document.querySelectorAll('.links a[download]')].map(a => a.download)") == list(
            RESULTS
        )
        # Nothing in a name became part of the page.
        assert HOSTILE in browser.value("document.getElementById('chosen').innerText")
        assert browser.value("document.querySelectorAll('main img').length") == 0
        browser.ask("Emulation.setDeviceMetricsOverride", width=390, height=800, deviceScaleFactor=1, mobile=True)
        assert browser.value("document.documentElement.scrollWidth") <= 390
        assert (
            browser.value(f"[...document.querySelectorAll('button, input, iframe, a')].filter({UNNAMED}).length") == 0
        )
        requests = {event["request"]["url"] for event in browser.events("Network.requestWillBeSent")}
        assert all(url.startswith((f"http://127.0.0.1:{site.port}/", "data:")) for url in requests)
        complaints = ("Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded")
        assert [browser.events(complaint) for complaint in complaints] == [[], [], []]
