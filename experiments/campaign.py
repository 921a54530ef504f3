"""The whole of `explain` on rotors with more detail than its model: drawn, explained, scored.

Cases are those of `benchmarks/detailed`: integrated in time by code that shares nothing with rotorjax. Rows are kept as
they end; given the same folder again, the rest is done. Seeds below 1200 are for development, and 4900 to 4999 for that
with shafts of finite elements, which all have from 4900 on.

    python experiments/campaign.py --first 1200 --seeds 200 --output output/campaign
    python experiments/campaign.py --first 1200 --seeds 200 --write output/cases        # files for another tool
    python experiments/campaign.py --first 5080 --seeds 40 --healthy --output output/healthy    # beside a healthy table
    python experiments/campaign.py --score answers.csv --truth output/cases-answers.jsonl --output output/other
    python experiments/campaign.py --score benchmarks/results/campaign_[23]*/rows.jsonl --output benchmarks/results/all
"""

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "benchmarks"))

from rotorjax.batch.case import Case as Job
from rotorjax.batch.pool import Processes, processors
from rotorjax.batch.runner import Progress, run
from rotorjax.batch.store import Store

from detailed.case import FINITE_ELEMENTS, KINDS, NOISES, Case, draw
from detailed.files import truth, write, write_case
from score_page import write_page
from scoring import judged, read_answers, read_rows

ROWS = "rows.jsonl"
"""All rows of a run, to be scored again."""
SEEN = 1200
"""Seeds below were looked at while the method and the cases were made."""


def explained(seed: int) -> dict[str, Any]:
    """One case: what is true, what was answered, and how long that took."""
    return _row(draw(seed), None)


def explained_since_healthy(seed: int) -> dict[str, Any]:
    """The same beside a measurement of the healthy rotor, taken as the case was, with noise of its own."""
    case = draw(seed)
    return _row(case, case.healthy())


def _row(case: Case, healthy: Case | None) -> dict[str, Any]:
    # Here, so that what scores and writes needs no JAX.
    from rotorjax import explain, read_measurement, read_rig  # noqa: PLC0415
    from rotorjax.compilation import spare_memory, use_double_precision  # noqa: PLC0415

    from answers import answer  # noqa: PLC0415
    from from_truth import against_truth, left_by_answer  # noqa: PLC0415
    from further_readings import after_further_readings  # noqa: PLC0415

    use_double_precision()
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as other:
        rig_file, table = write_case(case, Path(folder))
        rig, before = read_rig(rig_file), None
        if healthy is not None:
            rig_file, healthy_table = write_case(healthy, Path(other))
            rig = read_rig(rig_file)
            before = read_measurement(healthy_table, rig)
        measurement = read_measurement(table, rig)
    begin = time.perf_counter()
    found = explain(rig.model, measurement, healthy=before)
    seconds, true = time.perf_counter() - begin, truth(case)
    row = {**true, **answer(found), "took": seconds, "code": code()}
    row |= against_truth(found, true) | {"left_by_answer": left_by_answer(case, found)}
    row |= {"further_readings": after_further_readings(case, found) if healthy is None else None}
    spare_memory()
    return row


def told(progress: Progress) -> None:
    """Print the case that ended last."""
    latest = progress.latest
    if latest is not None and latest.row is not None:
        row = json.loads(latest.row)
        hidden = " + ".join(filter(None, [row["mistake"], row["outside"], *row["effects"]])) or "nothing"
        words = [str(row["seed"]), hidden, row["verdict"], " + ".join(row["named"]), judged(row)]
        print(" | ".join(words), f"({row['took']:.0f} s)", flush=True)
    elif latest is not None:
        print(latest.name, "|", latest.failure, flush=True)


def sources() -> str:
    """A digest of the code that the rows depend on."""
    digest = hashlib.sha256()
    files = [*(ROOT / "rotorjax").rglob("*.py"), *(ROOT / "benchmarks" / "detailed").rglob("*.py")]
    asked = [ROOT / "benchmarks" / name for name in ("answers.py", "from_truth.py", "further_readings.py")]
    for file in [*sorted(files), *asked]:
        digest.update(file.read_bytes())
    return digest.hexdigest()


def code() -> str:
    """The state of the code: its commit, and whether files differ from it."""
    git = ["git", "-C", str(ROOT)]
    commit = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True, check=False).stdout.strip()
    watched = ["rotorjax", "benchmarks", "experiments", ":!benchmarks/results"]
    changed = subprocess.run([*git, "status", "--porcelain", *watched], capture_output=True, text=True, check=False)
    return commit + (" and changes" if changed.stdout.strip() else "")


def about(rows: list[dict[str, Any]]) -> dict[str, str]:
    """Seeds and states of the code."""
    seeds = [row["seed"] for row in rows]
    states = ", ".join(sorted({row["code"] for row in rows if "code" in row})) or "another tool"
    return {"seeds": f"{min(seeds)} to {max(seeds)}", "answered by": states, "scored by": code()}


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=SEEN, help="seed to begin with (%(default)s)")
    parser.add_argument("--seeds", type=int, default=100, help="number of cases (%(default)s)")
    parser.add_argument("--workers", type=int, default=processors(), help="processes at one time (%(default)s)")
    parser.add_argument("--output", type=Path, help="folder for rows, scores and pictures")
    what = (
        "beside a measurement of the healthy rotor; cases with a mistake, of one of the two tables only, are left out"
    )
    parser.add_argument("--healthy", action="store_true", help=what)
    parser.add_argument("--write", type=Path, metavar="FOLDER", help="write the cases as rig files and tables, no more")
    what = f"score the answers of another tool, or {ROWS} of records, together"
    parser.add_argument("--score", type=Path, nargs="+", metavar="ANSWERS.csv", help=what)
    parser.add_argument("--truth", type=Path, help="with --score: what is true, as --write leaves it beside its folder")
    return parser.parse_args()


def main() -> None:
    options = parsed()
    seeds = range(options.first, options.first + options.seeds)
    if options.write:
        write([draw(seed) for seed in seeds], options.write)
        return
    if options.output is None:
        sys.exit("--output FOLDER is needed")
    options.output.mkdir(parents=True, exist_ok=True)
    if options.score:
        rows = [
            row
            for file in sorted(options.score)
            for row in (read_rows(file) if file.suffix == ".jsonl" else read_answers(file, options.truth))
        ]
        names = ", ".join(file.name if len(options.score) == 1 else file.parent.name for file in sorted(options.score))
        print(write_page(rows, options.output, {"answers": names, **about(rows)}))
        return
    if options.first < FINITE_ELEMENTS < options.first + options.seeds:
        sys.exit(f"seeds from {FINITE_ELEMENTS} on are of other rotors: give those below in a run of their own")
    cases = "detailed rotor" if options.first < FINITE_ELEMENTS else "finite-element rotor"
    configuration = {"cases": cases, "kinds": list(KINDS), "noises": list(NOISES), "sources": sources()}
    if options.healthy:
        configuration |= {"healthy": True}
        seeds = [seed for seed in seeds if not KINDS[seed % len(KINDS)].startswith("mistake")]
    function = explained_since_healthy if options.healthy else explained
    with Store(options.output / "rows.sqlite", configuration) as store:
        run(function, [Job(str(seed), seed) for seed in seeds], store, Processes(options.workers), told)
        kept = store.rows()
    failed = [f"{row['name']}: {row['failure']}" for row in kept if row["failure"]]
    rows = sorted((row for row in kept if not row["failure"]), key=lambda row: row["seed"])
    lines = [json.dumps(row, sort_keys=True) for row in rows]
    (options.output / ROWS).write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(write_page(rows, options.output, {**configuration, **about(rows), "failed": failed or "none"}))


if __name__ == "__main__":
    main()
