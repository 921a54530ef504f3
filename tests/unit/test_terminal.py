"""The command line and its terminal: tables fit, every option has help, effects are found by meaning, names from files
do nothing.
"""

import argparse
import json
import re
import subprocess
import sys

import pytest

from rotorjax import diagnose, effects, explain, read_measurement, read_rig, tell
from rotorjax.cli import _parser, main
from rotorjax.data.example import write_example
from rotorjax.data.names import harmless, unseen
from rotorjax.data.synonyms import SYNONYMS, meant_by, nearest_effect
from rotorjax.reporting.comparison import comparison_text
from rotorjax.reporting.diagnosis import diagnosis_text
from rotorjax.reporting.explanation import explanation_text
from rotorjax.reporting.tables import Table, laid_out, wrapped

from helpers import HEADER, RIG, ROWS, write

WIDTHS = (60, 80, 100, 200)
ESCAPE, OVERRIDE = "\x1b[31m", "\u202e"


def run(*arguments) -> int:
    return main([str(a) for a in arguments])


@pytest.fixture(scope="module")
def texts(tmp_path_factory):
    """What `compare`, `explain` and `diagnose` print of the example, as functions of the width."""
    folder = tmp_path_factory.mktemp("example")
    write_example(folder)
    rig = read_rig(folder / "rig.toml")
    measurement = read_measurement(folder / "measurement.csv", rig)
    story = tell(rig.model, measurement, [effects.ResidualUnbalance(), effects.CrossCoupling()])
    found = explain(rig.model, measurement, thorough=False)
    diagnosis = diagnose(rig.model, measurement)
    return {
        "compare": lambda width: comparison_text(story, width=width),
        "explain": lambda width: explanation_text(found, rig, width=width),
        "diagnose": lambda width: diagnosis_text(diagnosis, rig, measurement, width=width),
    }


def heads(text: str) -> list[list[str]]:
    """The heads of every table: the line above its rule."""
    lines = text.splitlines()
    return [re.split(r" {2,}", lines[k - 1].strip()) for k, line in enumerate(lines) if re.fullmatch(r"-[- ]*--", line)]


@pytest.mark.parametrize("command", ["compare", "explain", "diagnose"])
@pytest.mark.parametrize("width", WIDTHS)
def test_what_is_printed_fits_the_terminal(texts, command, width):
    unlimited, fitted = texts[command](None), texts[command](width)
    assert max(map(len, fitted.splitlines())) <= width
    assert len(heads(fitted)) == len(heads(unlimited)) > 0
    for kept, every in zip(heads(fitted), heads(unlimited), strict=True):
        assert set(kept) <= set(every), "no head is wrapped or shortened"
        assert kept[0] == every[0]
    narrower = heads(fitted) != heads(unlimited)
    assert ("Left out to fit the terminal:" in fitted) == narrower
    assert ("Columns were left out: a wider terminal, or --" in " ".join(fitted.split())) == narrower
    assert width < 200 or not narrower


def test_columns_left_out_are_named(texts):
    told = " ".join(re.findall(r"Left out to fit the terminal: ((?:.+\n)+)", texts["compare"](60)))
    for head in ("model µm", "amplitude ratio", "phase error °", "std. errors", "prior ±", "reduced chi² (1 = noise)"):
        assert head in " ".join(told.split())


def test_a_file_or_a_pipe_takes_lines_of_any_length(texts):
    for text in texts.values():
        assert "Left out" not in text(None)
    assert max(map(len, texts["explain"](None).splitlines())) > 200


def test_text_is_wrapped_in_its_cell_before_a_column_goes():
    table = Table("", ["name", "value", "what it is"], [["a", "1.0", "words " * 12]], spare=["value"])
    assert max(map(len, table.text(50).splitlines())) <= 50
    assert "value" in table.text(50)
    assert table.text(50).count("words") == 12
    narrow = table._replace(rows=[["some_effect.some_parameter_n_per_m", "1.0", "words " * 12]]).text(40)
    assert max(map(len, narrow.splitlines())) <= 40
    assert "some_effect.\n" in re.sub(" +", "", narrow).replace("words", "")
    assert "Left out to fit the terminal: value" in narrow


def test_paragraphs_hang_and_what_is_indented_stays():
    text = "- " + "word " * 20 + "\n    paste = { this = 1.0 }" + " " * 60 + "#"
    lines = wrapped(text, 50).splitlines()
    assert [line[:2] for line in lines] == ["- ", "  ", "  ", "  "]
    assert lines[-1].startswith("    paste")
    assert laid_out([text], None) == text


@pytest.mark.parametrize("width", [60, 80])
def test_the_command_line_asks_the_terminal_for_its_width(capsys, monkeypatch, width):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", str(width))
    for arguments in (["effects"], ["effects", "crack"], ["effects", "whirl"]):
        assert run(*arguments) == 0
        out = capsys.readouterr().out
        assert max(map(len, out.splitlines())) <= width
    monkeypatch.setattr(sys.stdout, "isatty", lambda: False)
    assert run("effects") == 0
    assert max(map(len, capsys.readouterr().out.splitlines())) > 100


def parsers(parser: argparse.ArgumentParser):
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for choice in action.choices.values():
                yield from parsers(choice)


def test_every_command_option_and_argument_has_help():
    seen = 0
    for parser in parsers(_parser()):
        assert parser.description
        for action in parser._actions:
            if isinstance(action, argparse._SubParsersAction):
                assert {choice.dest for choice in action._choices_actions} == set(action.choices)
                assert all(choice.help for choice in action._choices_actions)
            else:
                assert action.help, f"{parser.prog} {action.option_strings or action.dest}"
                seen += 1
    assert seen > 30


def test_help_and_catalogue_start_without_jax():
    code = (
        "import sys\nfrom rotorjax.cli import main\n"
        "for arguments in (['effects'], ['effects', 'whirl'], ['effects', 'nothing-like-it'], ['explain', '--help']):\n"
        "    try:\n        main(arguments)\n    except SystemExit:\n        pass\n"
        "assert 'jax' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def test_every_effect_has_words_of_the_field():
    assert set(SYNONYMS) == set(effects.CATALOG)
    assert all(len(words) >= 4 for words in SYNONYMS.values())


@pytest.mark.parametrize(
    ("word", "effect"),
    [
        ("oil_whirl", "cross_coupling"), ("whip", "cross_coupling"), ("Seal", "cross_coupling"),
        ("alford force", "cross_coupling"), ("keyway", "asymmetric_shaft"), ("two-pole", "asymmetric_shaft"),
        ("bent_shaft", "residual_bow"), ("hot spot", "thermal_bow"), ("thermal bend", "thermal_bow"),
        ("loose_foundation", "foundation"), ("soft foot", "foundation"), ("rotor rub", "rub"),
        ("breathing-crack", "crack"), ("coupling_misalignment", "misalignment"), ("glitch", "runout"),
        ("keyphasor offset", "phase_reference_offset"), ("keyphasor", "phase_reference_offset"),
        ("probe_sensitivity", "probe_gain"), ("swapped probes", "probe_angle"), ("imbalance", "residual_unbalance"),
        ("cros_coupling", "cross_coupling"), ("crak", "crack"), ("cross", "cross_coupling"),
    ],
)  # fmt: skip
def test_nearest_names_by_meaning_and_by_spelling(word, effect):
    assert nearest_effect(word, effects.CATALOG).startswith(f"did you mean {effect!r}")


def test_several_meanings_and_none():
    assert set(meant_by("looseness", effects.CATALOG)) == {"foundation", "clearance"}
    assert nearest_effect("looseness", effects.CATALOG).count("(looseness)") == 2
    assert nearest_effect("xyzzy", effects.CATALOG) == "`rotorjax effects` lists those there are"
    assert "cross_coupling" not in meant_by("oil whirl", ["rub", "crack"])


@pytest.mark.parametrize("option", ["--only", "--exclude", "--effect"])
def test_options_name_the_effect_that_is_meant(tmp_path, capsys, option):
    data, toml = write(tmp_path)
    assert run("compare" if option == "--effect" else "explain", data, "--rig", toml, option, "oil_whirl") == 2
    assert "'oil_whirl'; did you mean 'cross_coupling' (oil whirl)?" in capsys.readouterr().err


def test_sections_name_the_effect_that_is_meant(tmp_path, capsys):
    for section in ("effects", "prior"):
        data, toml = write(tmp_path, rig=RIG + f'[{section}."hot spot"]\nbow = 1.0\n')
        assert run("compare", data, "--rig", toml) == 2
        assert f"rig.toml:11: {section}.hot spot: unknown effect; did you mean 'thermal_bow'" in capsys.readouterr().err


def test_a_word_lists_the_effects_about_it(capsys):
    assert run("effects", "whirl") == 0
    out = capsys.readouterr().out
    assert "No effect is called 'whirl'; these are about it" in out
    assert {"cross_coupling", "internal_damping", "rub", "gyroscopic"} <= set(re.findall(r"\w+", out))
    assert run("effects", "oil whip") == 0
    assert "cross_coupling" in capsys.readouterr().out
    assert run("effects", "cros_coupling") == 2
    assert "did you mean 'cross_coupling'?" in capsys.readouterr().err


def test_characters_that_are_not_seen():
    assert unseen("trial-a µ 日本 $x^$ <b>") is None
    assert [unseen(f"a{c}b") for c in "\x1b\r\b\u202e\u200b\u2028\x85\udcff"] == [
        "U+001B", "U+000D", "U+0008", "U+202E", "U+200B", "U+2028", "U+0085", "U+DCFF",
    ]  # fmt: skip
    assert harmless("a\x1b[2Jb\n\u202e\udcffµ") == "a\\x1b[2Jb\n\\u202e\\udcffµ"


@pytest.mark.parametrize(
    ("rig", "words"),
    [
        (RIG.replace("[runs.trial-a]", '[runs."trial\\u001b[31m"]'), "rig.toml:9: runs.trial\\x1b[31m: run name holds"),
        (RIG.replace("X = {", '"X\u202e" = {'), "rig.toml:6: probes.X\\u202e: probe name holds the control character"),
        (RIG + '[planes."a\\r"]\n', "rig.toml:11: planes.a\\r: plane name holds the control character U+000D; delete"),
        (RIG + '[recordings."a\u200b.mat"]\nrun = "baseline"\n', "file name holds the control character U+200B"),
        (RIG.replace("[probes]", 'gravity = "\\u001b[2J"\n[probes]'), "rig.toml:5: rotor.gravity: '\\x1b[2J' is not"),
    ],
)
def test_names_with_control_characters_are_refused_in_a_rig_file(tmp_path, capsys, rig, words):
    data, toml = write(tmp_path, rig=rig)
    assert run("compare", data, "--rig", toml, "--json", tmp_path / "c.json") == 2
    err = capsys.readouterr().err
    assert words in err
    assert not set(err) & {"\x1b", "\r", "\u202e", "\u200b"}
    assert not (tmp_path / "c.json").exists()


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (
            "\n".join([HEADER, f"base{ESCAPE}{ROWS[0]}"]),
            "data.csv:2: column 1 (run): holds the control character U+001B",
        ),
        ("\n".join([HEADER, ROWS[0].replace(",X,", ",X\b,")]), "column 3 (probe): holds the control character U+0008"),
        ("\n".join([HEADER, f"a\u2028{ROWS[0]}"]), "data.csv:2: column 1 (run): holds the control character U+2028"),
        ("\n".join([HEADER + f",no{ESCAPE}te", ROWS[0] + ",a,b"]), "data.csv:1: column 8 ('no\\x1b[31mte') is ignored"),
    ],
)
def test_names_with_control_characters_are_refused_in_a_table(tmp_path, capsys, table, words):
    data, toml = write(tmp_path, table=table)
    assert run("compare", data, "--rig", toml) == 2
    caught = capsys.readouterr()
    assert words in caught.err
    assert "\x1b" not in caught.out + caught.err


def test_hostile_file_names_do_nothing(tmp_path, capsys):
    """In messages, notes, usage, the report and the line that says where it is."""
    data, toml = write(tmp_path)
    odd = data.rename(tmp_path / f"{ESCAPE}{OVERRIDE}<b>\udcff.csv")
    report = tmp_path / f"{ESCAPE}.html"
    assert run("compare", odd, "--rig", toml, "--report", report) == 0
    assert run("compare", f"{odd}x", "--rig", toml) == 2
    assert run("effects", ESCAPE) == 2
    with pytest.raises(SystemExit):
        run("compare", odd, "--rig", toml, f"more{ESCAPE}")
    caught = capsys.readouterr()
    assert "\\x1b[31m" in caught.out
    assert "\\x1b[31m" in caught.err
    assert not set(caught.out + caught.err) & {"\x1b", OVERRIDE, "\udcff"}
    page = report.read_text(encoding="utf-8")
    assert "\\x1b[31m\\u202e&lt;b&gt;\\udcff.csv against rig.toml" in page
    assert not set(page) & {"\x1b", OVERRIDE}


@pytest.mark.parametrize("name", ["$x^$", "a|b`c`<i>{{7*7}}", "_hidden", '"q" \\x1b'])
def test_odd_but_honest_names_are_shown_as_they_are(tmp_path, name):
    """Formulas of the drawing library, Markdown, HTML and templates among them."""
    rows = [row.replace("baseline", '"' + name.replace('"', '""') + '"') for row in ROWS]
    rig = RIG.replace("[runs.baseline]", f"[runs.{json.dumps(name)}]")
    data, toml = write(tmp_path, rig=rig, table="\n".join([HEADER, *rows]))
    outputs = ("--report", tmp_path / "r.html", "--json", tmp_path / "c.json")
    assert run("compare", data, "--rig", toml, "--effect", "residual_unbalance", *outputs) == 0
    assert name in json.loads((tmp_path / "c.json").read_text(encoding="utf-8"))["share"]["run"]
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "<i>" not in page
    assert name.replace("<i>", "&lt;i&gt;").replace('"', "&#34;") in page
