"""The notebooks: committed as executed, and executed anew, so that a number which leaves its tolerance fails here."""

import shutil
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

from helpers import with_campaign

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
LARGEST_KB = 500
SECONDS = 600
"""For one cell."""

SLOW = ("07_an_effect_of_your_own",)

every_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def code_cells(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def test_all_are_there():
    assert [path.name[:2] for path in NOTEBOOKS] == ["01", "02", "03", "04", "05", "06", "07", "08"]


@every_notebook
def test_committed_as_executed(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    cells = code_cells(notebook)
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    outputs = [output for cell in cells for output in cell.outputs]
    assert not [output for output in outputs if output.output_type == "error"]
    assert not [output for output in outputs if output.get("name") == "stderr"]
    assert not [cell.id for cell in notebook.cells if "execution" in cell.metadata], (
        "committed with times of execution, which differ from run to run"
    )
    assert [cell.id for cell in notebook.cells] == [f"cell-{k:02d}" for k in range(1, len(notebook.cells) + 1)]
    assert path.stat().st_size < 1024 * LARGEST_KB


@every_notebook
def test_asserts_and_shows_something(path):
    notebook = nbformat.read(path, as_version=4)
    cells = code_cells(notebook)
    assert 'jax.config.update("jax_enable_x64", True)' in cells[0].source
    assert any(line.lstrip().startswith("assert ") for cell in cells for line in cell.source.splitlines())
    assert any("image/png" in output.get("data", {}) for cell in cells for output in cell.outputs)


@pytest.mark.parametrize(
    "path",
    with_campaign(NOTEBOOKS, lambda path: path.stem in SLOW),
    ids=lambda path: path.stem,
)
def test_executes_anew(path, tmp_path):
    folder = tmp_path / "notebooks"
    folder.mkdir()
    if (benchmarks := ROOT / "benchmarks").exists():
        shutil.copytree(benchmarks, tmp_path / "benchmarks", ignore=shutil.ignore_patterns("__pycache__"))
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(
        notebook,
        timeout=SECONDS,
        kernel_name="python3",
        record_timing=False,
        resources={"metadata": {"path": str(folder)}},
    )
    client.execute()
    assert all(cell.execution_count for cell in code_cells(notebook))
