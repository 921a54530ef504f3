"""What the user of `explain` waits for: each explanation in a process of its own, with an empty and with a filled cache
of compiled programs.

Prints, and writes as a table, for each measurement: seconds of the whole process but for drawing the data,
linearisations, peak memory, programs compiled or taken from the cache, the seconds of that, and the verdict. The
example and the RK4 vectors are explained by the command line; a strong cubic spring and a rub with friction (60 cases
each, `benchmarks/regret.py`) from Python, with the right rig and with one that states a weight that is not there; then
springs and a rub beside an unbalance that nobody knows, and three that the model cannot explain, or hardly: a crack
that opens and closes at once, a probe that saturates, a spring of the fifth power.

    python benchmarks/waits.py --output benchmarks/results
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from importlib.resources import as_file, files
from pathlib import Path
from typing import NamedTuple

import jax
import regret
import tabulate
from timing import timed

from rotorjax import explain
from rotorjax.cli import main as command_line
from rotorjax.compilation import use_double_precision
from rotorjax.data.files import write_whole

DRAWN = {
    "cubic spring, 60 cases": ("strong_cubic", 0),
    "cubic spring, weight stated": ("strong_cubic", 1),
    "rub with friction, 60 cases": ("rub_with_friction", 0),
    "rub with friction, weight stated": ("rub_with_friction", 1),
    "weak cubic spring and unbalance": ("beside_an_unbalance", 0),
    "cubic spring and unbalance": ("beside_an_unbalance", 1),
    "rub and unbalance": ("beside_an_unbalance", 2),
    "crack that switches": ("hard_to_explain", 0),
    "saturating probe": ("hard_to_explain", 1),
    "spring of the fifth power": ("hard_to_explain", 2),
}
"""Name -> function of `benchmarks/regret.py`, and which of its problems."""
COLUMNS = ("measurement", "cache", "seconds", "linearisations", "GB", "programs", "compiling, s", "verdict")


class Wait(NamedTuple):
    """One explanation."""

    seconds: float
    linearisations: int
    gigabytes: float
    compiled: int
    compiling: float
    """Seconds of the compiler, of which two programs may take some at one time."""
    verdict: str


def explained(name: str, folder: Path, cache: Path) -> Wait:
    """In a new process."""
    told = folder / "told.json"
    begin = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, __file__, "--one", name, str(folder), str(told)],
        env={**os.environ, "JAX_COMPILATION_CACHE_DIR": str(cache)},
    )
    _, status, used = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - begin
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"{name}: its process failed")
    found = json.loads(told.read_text())
    return Wait(
        seconds - found.get("drawing", 0.0),
        found["linearisations"],
        used.ru_maxrss / 1e6,
        found["compiled"],
        found["compiling"],
        found["verdict"],
    )


def one(name: str, folder: Path, told: Path) -> None:
    """In its process: explain, and say what it took."""
    compiled: list[float] = []

    def listen(event: str, seconds: float, **_: object) -> None:
        if event.endswith("backend_compile_duration"):
            compiled.append(seconds)

    jax.monitoring.register_event_duration_secs_listener(listen)
    found = (
        _drawn(*DRAWN[name], compiled)
        if name in DRAWN
        else _command(folder if name == "example" else None, folder / "answer.json")
    )
    write_whole(told, json.dumps({**found, "compiled": len(compiled), "compiling": sum(compiled)}))


def _command(folder: Path | None, answer: Path) -> dict[str, object]:
    """By the command line: the tables of a folder, or the RK4 vectors."""
    with as_file(files("rotorjax") / "data" / "rk4") as rk4:
        data = folder or rk4
        status = command_line(
            ["explain", str(data / "measurement.csv"), "--rig", str(data / "rig.toml"), "--json", str(answer)]
        )
    if status:
        raise RuntimeError(f"{data}: status {status}")
    found = json.loads(answer.read_text())
    return {
        "linearisations": found["cost"]["linearisations"],
        "verdict": f"{found['verdict']}: {', '.join(found['effects'])}",
    }


def _drawn(function: str, which: int, compiled: list[float]) -> dict[str, object]:
    """From Python. **Arguments:** ``compiled``: programs so far, emptied of those that drawing the data took."""
    use_double_precision()
    problem, seconds = timed(lambda: getattr(regret, function)()[which])
    compiled.clear()
    found = explain(problem.model, problem.measurement, progress=lambda line: print(line, file=sys.stderr))
    return {
        "linearisations": found.cost.linearisations,
        "verdict": f"{found.verdict}: {', '.join(found.named)}",
        "drawing": seconds,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", help="these measurements")
    parser.add_argument("--output", type=Path, help="folder for the table")
    parser.add_argument("--one", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        one(options.one[0], *map(Path, options.one[1:]))
        return
    if options.output:
        options.output.mkdir(parents=True, exist_ok=True)
    rows = []
    with tempfile.TemporaryDirectory() as place:
        folder, cache = Path(place) / "example", Path(place) / "cache"
        subprocess.run(
            [Path(sys.executable).with_name("rotorjax"), "example", folder], check=True, stdout=subprocess.DEVNULL
        )
        for name in options.only or ["example", "rk4", *DRAWN]:
            for state in ("empty", "filled"):
                wait = explained(name, folder, cache / name.replace(" ", "_"))
                rows.append(
                    (
                        name,
                        state,
                        f"{wait.seconds:.1f}",
                        f"{wait.linearisations:,}",
                        f"{wait.gigabytes:.2f}",
                        wait.compiled,
                        f"{wait.compiling:.0f}",
                        wait.verdict,
                    )
                )
                print(*rows[-1], sep=" | ", flush=True)
    table = tabulate.tabulate(rows, COLUMNS, tablefmt="github", disable_numparse=True)
    if options.output:
        write_whole(options.output / "waits.md", f"# {(__doc__ or '').splitlines()[0]}\n\n{table}\n")
    else:
        print(table)


if __name__ == "__main__":
    main()
