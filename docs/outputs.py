"""Run the commands shown on the pages and put their output below them, so that it is what the package prints.

    python docs/outputs.py             every page
    python docs/outputs.py docs/guide/explain.md

A block marked `console` begins with a command after `$ `, which may go on after a backslash; the rest of the block is
its output. The commands of a page run one after the other in an empty folder, in which `demo` holds the shipped example
unless the page makes it, and `rk4` the measured vectors of a rotor kit. Then its Python is run there.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import textwrap
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
_PYTHON = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
WIDTH = 110
_BLOCK = re.compile(r"^```console\n\$ (?P<command>.*?[^\\])\n(?P<output>.*?)^```$", re.MULTILINE | re.DOTALL)


def main() -> None:
    """Renew the pages named, or all that show commands."""
    pages = [Path(name).resolve() for name in sys.argv[1:]] or sorted((ROOT / "docs").rglob("*.md"))
    for page in pages:
        text = page.read_text(encoding="utf-8")
        if _BLOCK.search(text):
            with tempfile.TemporaryDirectory() as folder:
                page.write_text(renewed(text, Path(folder)), encoding="utf-8")
                code = "\n".join(_PYTHON.findall(text))
                subprocess.run(
                    [sys.executable, "-c", code], cwd=folder, env=_environment(), stdout=subprocess.DEVNULL, check=True
                )
            print(page.relative_to(ROOT))


def renewed(text: str, folder: Path) -> str:
    """The page with the output of its commands."""
    shutil.copytree(ROOT / "rotorjax" / "data" / "rk4", folder / "rk4")
    if "$ rotorjax example demo\n" not in text:
        shutil.copytree(ROOT / "rotorjax" / "data" / "example", folder / "demo")
    return _BLOCK.sub(lambda block: f"```console\n$ {block['command']}\n{_run(block['command'], folder)}```", text)


def _run(command: str, folder: Path) -> str:
    """What a command prints, and what it says of bad input; stages of its progress are left out."""
    done = subprocess.run(
        ["bash", "-c", command], cwd=folder, env=_environment(), capture_output=True, text=True, check=False
    )
    said = [line for line in done.stderr.splitlines(keepends=True) if line.startswith("rotorjax:")]
    status = f"(exit status {done.returncode})\n" if done.returncode else ""
    lines = "".join([*said, done.stdout, status]).splitlines()
    return "".join(f"{part.rstrip()}\n" for line in lines for part in _wrapped(line))


def _environment() -> dict[str, str]:
    """This package, and the commands that came with this Python, first."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return {**os.environ, "PATH": path, "PYTHONPATH": str(ROOT)}


def _wrapped(line: str) -> list[str]:
    """A line as a terminal shows it; rows of tables stay whole."""
    return [line] if len(line) <= WIDTH or "  " in line.strip() else textwrap.wrap(line, WIDTH)


if __name__ == "__main__":
    main()
