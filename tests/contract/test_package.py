"""The package's public face and its inner order."""

import ast
import subprocess
import sys
from pathlib import Path

import rotorjax

ROOT = Path(rotorjax.__file__).parent
LAYERS = [
    "shown", "errors", "units", "arrays", "compilation", "model", "effects", "physics", "data",
    "inference", "diagnosis", "discovery", "reporting", "batch", "paper", "web", "cli", "__main__",
]  # fmt: skip
LEVEL = {name: level for level, name in enumerate(LAYERS)}
PUBLIC = {
    "AbstractRotor", "Cell", "Comparison", "Conditions", "Diagnosis", "Effect", "Estimate", "Excitation",
    "ExcitationEffect", "Explanation", "Fault", "Fit", "HarmonicBalance", "InputError", "Jeffcott",
    "Knowledge", "Layout", "Matrices", "MatrixEffect", "Measurement", "Model", "OperatingPoint", "Probes", "Reading",
    "ReadingEffect", "Rig", "Rival",
    "RunDiagnosis", "SpeedEffect", "Story", "Support", "SupportEffect", "compare", "diagnose", "effects", "explain",
    "fit", "fit_steps", "Instant", "RestoringEffect", "WaveformEffect", "parameter", "read_measurement", "read_rig",
    "response", "rivals", "tell",
    "SteadyStates", "steady_states", "Healthy", "calibrated",
}  # fmt: skip


def test_public_names():
    assert set(rotorjax.__all__) == PUBLIC
    assert len(PUBLIC) <= 60
    for name in PUBLIC:
        assert getattr(rotorjax, name) is not None


def imported_at_run_time(node: ast.AST):
    """Imports anywhere but under `if TYPE_CHECKING`."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.ImportFrom):
            yield child
        elif not (isinstance(child, ast.If) and isinstance(child.test, ast.Name) and child.test.id == "TYPE_CHECKING"):
            yield from imported_at_run_time(child)


def test_imports_point_one_way():
    for path in ROOT.rglob("*.py"):
        here = path.relative_to(ROOT).parts[0].removesuffix(".py")
        if here == "__init__":
            continue
        for node in imported_at_run_time(ast.parse(path.read_text(encoding="utf-8"))):
            if (node.module or "").startswith("rotorjax."):
                there = node.module.split(".")[1]
                assert LEVEL[there] <= LEVEL[here], f"{path.name} imports {node.module}"


def test_files_stay_readable():
    for path in ROOT.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        assert len(text.splitlines()) <= 400, path
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                lines = node.end_lineno - node.lineno + 1
                assert lines <= 50, f"{path.name}: {node.name}"


def test_matplotlib_and_printing_have_one_home():
    for path in ROOT.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        if path.parent.name not in {"plots", "pictures"} and path.name != "figures.py":
            assert "matplotlib" not in text.replace("matplotlib figure", ""), path
        if "cli" not in path.relative_to(ROOT).parts:
            assert not any(isinstance(n, ast.Name) and n.id == "print" for n in ast.walk(ast.parse(text))), path


def test_import_changes_no_setting_and_loads_no_jax():
    code = (
        "import sys, rotorjax; assert 'jax' not in sys.modules; rotorjax.Jeffcott; import jax; assert not "
        "jax.config.jax_enable_x64"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
