"""The command line. The only place that prints or sets JAX's global options."""

import argparse
import contextlib
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import NoReturn

from rotorjax.cli import commands, recordings
from rotorjax.cli.many import explain_many
from rotorjax.cli.progress import INTERRUPTED, interruptible
from rotorjax.cli.serve import serve
from rotorjax.cli.terminal import accept_any_character, complain, leave_output
from rotorjax.data.names import harmless
from rotorjax.errors import InputError

BAD_INPUT = 2
ENDING_THEMSELVES = (explain_many, serve)
"""Commands that end other processes, or answer whoever waits, before they end at Ctrl-C."""


def main(arguments: list[str] | None = None) -> int:
    """Run one command. **Returns** the exit status: 0 done, 2 bad input."""
    accept_any_character()
    parser = _parser()
    options = parser.parse_args(arguments)
    try:
        with contextlib.nullcontext() if options.command in ENDING_THEMSELVES else interruptible():
            options.command(options)
    except InputError as error:
        for problem in error.shown():
            complain(problem)
        return BAD_INPUT
    except KeyboardInterrupt:
        complain("stopped")
        return INTERRUPTED
    except BrokenPipeError:
        leave_output()
    return 0


class _Parser(argparse.ArgumentParser):
    """A parser whose messages repeat no control characters of its arguments."""

    def error(self, message: str) -> NoReturn:
        """Usage and message on standard error, then exit status 2."""
        argparse.ArgumentParser.error(self, harmless(message))


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="rotorjax", description="Compare a rotor model with vibration measurements and find what it lacks."
    )
    parser.add_argument("--version", action="version", version=f"rotorjax {version('rotorjax')}")
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(name: str, run: Callable[[argparse.Namespace], None], what: str) -> argparse.ArgumentParser:
        sub = subparsers.add_parser(name, help=what.replace("%", "%%"), description=what)
        sub.set_defaults(command=run)
        return sub

    _compare(
        command(
            "compare", commands.compare, "where a model fails against a measurement; add effects, see the error fall"
        )
    )
    _explain(
        command(
            "explain", commands.explain, "which effect is missing, how sure, what ties with it, what to measure next"
        )
    )
    _explain_many(command("explain-many", explain_many, "explain every table of a folder, on all processors"))
    _serve(command("serve", serve, "a page on this machine to drop files on: explain in the browser"))
    _diagnose(command("diagnose", commands.diagnose, "unbalance and bow of every run, with 95 % intervals"))
    _simulate(command("simulate", commands.simulate, "make a measurement table from a model"))
    _vectors(command("vectors", recordings.vectors, "waveforms (recordings over time) to a measurement table"))
    sub = command("effects", commands.effects, "the catalogue of effects, or one of them in full")
    sub.add_argument("name", nargs="?", metavar="NAME", help="an effect of the catalogue; all of them by default")
    sub = command("paper", commands.paper, "every table and figure of Huang et al. 2026 (Sensors 26:2565), recomputed")
    what = "folder to write to (default: paper_tables)"
    sub.add_argument("--output", type=Path, default=Path("paper_tables"), metavar="DIR", help=what)
    sub = command("example", commands.example, "write a table, a rig file and what to type: a start for your own data")
    sub.add_argument("folder", type=Path, metavar="DIR", help="folder to write to, made if it does not exist")
    what = "waveforms (recordings over time) instead of a table, with a rig file that says what they are"
    sub.add_argument("--recordings", action="store_true", help=what)
    return parser


def _compare(sub: argparse.ArgumentParser) -> None:
    _inputs(sub)
    _healthy(sub)
    _effect_option(sub, "add this effect and fit what is not given")
    _outputs(sub, "write the fitted model as a rig file")


def _explain(sub: argparse.ArgumentParser) -> None:
    _inputs(sub)
    _healthy(sub)
    _race(sub)
    _outputs(sub, "write the explained model as a rig file")


def _explain_many(sub: argparse.ArgumentParser) -> None:
    what = (
        "folder of tables, each with a rig file of the same stem or rig.toml beside it; or list with columns data,rig"
    )
    sub.add_argument("source", type=Path, metavar="FOLDER|LIST.csv", help=what)
    what = "results, one row per table: .parquet, .sqlite or .csv"
    sub.add_argument("--output", type=Path, required=True, metavar="FILE", help=what)
    sub.add_argument("--report", type=Path, metavar="FILE.html", help="write an overview, first what needs attention")
    sub.add_argument("--reports", type=Path, metavar="DIR", help="write a report of every table into this folder")
    what = "so many processes at one time (default: one per processor)"
    sub.add_argument("--workers", type=int, metavar="N", help=what)
    sub.add_argument("--cluster", metavar="ADDRESS", help="use the workers of this Dask scheduler, tcp://host:8786")
    _race(sub)


def _serve(sub: argparse.ArgumentParser) -> None:
    what = "port of the page, 0 for any that is free (default: 8000)"
    sub.add_argument("--port", type=int, default=8000, metavar="N", help=what)
    sub.add_argument("--open", action="store_true", help="open the page in the browser")
    what = "largest table that is taken, in MB (default: 50)"
    sub.add_argument("--max-table-mb", type=float, default=50.0, metavar="MB", help=what)
    what = "most that recordings may have together, in MB (default: 1000)"
    sub.add_argument("--max-recordings-mb", type=float, default=1000.0, metavar="MB", help=what)


def _race(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--max-effects", type=int, default=3, metavar="N", help="add at most so many (default: 3)")
    what = "stop after so many linearisations, one run at one speed each (default: 750000, or 10000 a case)"
    sub.add_argument("--limit", type=int, metavar="N", help=what)
    sub.add_argument("--only", metavar="A,B", help="only these effects may be missing")
    sub.add_argument("--exclude", default="", metavar="A,B", help="these effects are not missing")
    mistakes = (
        "test mistakes in rig file and table too (rotation, signs, units, exchanged probes or runs, ...): always, or "
        "never; by default where nothing else explains the data, or an effect does that such a mistake may look like"
    )
    sub.add_argument("--mistakes", action=argparse.BooleanOptionalAction, help=mistakes)


def _diagnose(sub: argparse.ArgumentParser) -> None:
    _inputs(sub)
    what = "run whose installed faults are known, what else it shows is inherent; may be repeated"
    sub.add_argument("--reference", action="append", default=[], metavar="RUN", help=what)
    sub.add_argument("--json", type=Path, metavar="FILE", help="write the result as JSON")


def _simulate(sub: argparse.ArgumentParser) -> None:
    _rig(sub)
    what = sub.add_mutually_exclusive_group(required=True)
    what.add_argument("--like", type=Path, metavar="DATA.csv", help="the runs, speeds, probes and orders of this table")
    what.add_argument("--speeds", metavar="LOW:HIGH:COUNT", help="every run of the rig file at these speeds, in rpm")
    sub.add_argument("--orders", metavar="1,2", help="orders, with --speeds (default: 1)")
    _effect_option(sub, "add this effect")
    noise = "standard error of real and of imaginary part, in µm (default: 0)"
    sub.add_argument("--noise-um", type=float, default=0.0, metavar="SIGMA", help=noise)
    sub.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the noise (default: 0)")
    sub.add_argument("--output", type=Path, required=True, metavar="DATA.csv", help="table to write")


def _vectors(sub: argparse.ArgumentParser) -> None:
    what = "waveform files, or the rig file alone: then those that its [recordings] name"
    sub.add_argument("files", type=Path, nargs="*", metavar="FILE", help=what)
    sub.add_argument(
        "--rig", type=Path, metavar="RIG.toml", help="rig file: which channel is what, which run a file holds"
    )
    sub.add_argument("--orders", metavar="1,2", help="orders (default: those of the rig file, or 1)")
    rate = "sampling rate, where the file has no time (default: that of the rig file)"
    sub.add_argument("--sample-rate", type=float, metavar="HZ", help=rate)
    sub.add_argument("--output", type=Path, required=True, metavar="DATA.csv", help="table to write")
    what = "write vectors over speed, waveforms, orbits, spectra and cascades, one file"
    sub.add_argument("--report", type=Path, metavar="FILE.html", help=what)


def _inputs(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("data", type=Path, nargs="?", metavar="DATA.csv", help="measurement table, with --rig")
    _rig(sub, required=False)
    what = "instead of table and rig file: a rig file whose [recordings] name the waveforms (not a waveform file)"
    sub.add_argument("--recordings", type=Path, metavar="RIG.toml", help=what)


def _healthy(sub: argparse.ArgumentParser) -> None:
    what = "table of the healthy rotor, with its runs in the rig file: the model is calibrated on it first"
    sub.add_argument("--healthy", type=Path, metavar="HEALTHY.csv", help=what)


def _rig(sub: argparse.ArgumentParser, *, required: bool = True) -> None:
    what = "rig file: rotor, probes, what was installed in each run"
    sub.add_argument("--rig", type=Path, required=required, metavar="RIG.toml", help=what)


def _outputs(sub: argparse.ArgumentParser, rig: str) -> None:
    sub.add_argument("--write-rig", type=Path, metavar="NEW.toml", help=rig)
    sub.add_argument("--json", type=Path, metavar="FILE", help="write the result as JSON")
    sub.add_argument("--report", type=Path, metavar="FILE.html", help="write a report with pictures, one file")


def _effect_option(sub: argparse.ArgumentParser, what: str) -> None:
    sub.add_argument(
        "--effect", action="append", default=[], metavar="NAME[:PARAMETER=VALUE,...]", help=f"{what}; may be repeated"
    )
