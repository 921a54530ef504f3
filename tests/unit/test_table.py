"""Measurement tables: what is accepted, what is refused and with which words."""

import numpy as np
import pytest

from rotorjax import InputError, read_measurement, read_rig
from rotorjax.data.table import read_table

from helpers import HEADER, ROWS, write

BODY = "\n".join(ROWS) + "\n"


def read(folder, table, rig=None):
    data, toml = write(folder, table=table, **({} if rig is None else {"rig": rig}))
    return read_measurement(data, read_rig(toml))


def problems(folder, table, rig=None) -> str:
    with pytest.raises(InputError) as caught:
        read(folder, table, rig)
    return str(caught.value)


def test_values(tmp_path):
    m = read(tmp_path, f"{HEADER}\n{BODY}")
    assert m.runs == ("baseline", "trial-a")
    assert m.orders == (1.0,)
    assert m.noise == "given"
    assert m.vectors[0, 0, 0] == pytest.approx(19.93e-6 * np.exp(-1j * np.radians(31.4)))
    assert m.sigma[0, 0, 0] == pytest.approx(0.3e-6)
    np.testing.assert_array_equal(m.present[:, :, 0], [[True, True], [True, False]])
    np.testing.assert_allclose(m.conditions.unbalance[1, 0], [30e-6, 0.0])


@pytest.mark.parametrize(
    "table",
    [
        f"\ufeff{HEADER}\n{BODY}",
        f"{HEADER}\n{BODY}".replace("\n", "\r\n"),
        f"{HEADER}\n{BODY}\n\n  \n",
        f"{HEADER}\n{BODY}".replace(",", " , "),
        f"{HEADER}\n" + "\n".join(reversed(ROWS)),
        f"{HEADER},comment\n" + "\n".join(f"{row},a note" for row in ROWS),
        f"{HEADER}\n{BODY}".replace(",", ";").replace(".", ","),
    ],
    ids=["bom", "crlf", "blank lines", "blanks", "any order", "more columns", "semicolons and decimal commas"],
)
def test_accepted(tmp_path, table):
    m = read(tmp_path, table)
    cell = m.runs.index("trial-a")
    case = int(np.argmax(m.run == cell))
    assert m.vectors[case, 0, 0] == pytest.approx(30e-6 * np.exp(1j * np.radians(10.0)))
    assert int(m.present.sum()) == 3


def test_notes(tmp_path):
    data, _ = write(tmp_path, table=f"{HEADER},comment\n" + "\n".join(f"{row},x" for row in ROWS))
    assert "column 8 ('comment') is ignored" in read_table(data).notes[0]
    data, _ = write(tmp_path, table=f"{HEADER}\n{BODY}".replace(",", ";").replace(".", ","))
    assert "semicolons with decimal commas" in read_table(data).notes[0]


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("baseline,fast,X,1,1.0,0,0.3", ["data.csv:2: column 2 (speed_rpm): 'fast' is not a finite number"]),
        ("baseline,1500,X,1,nan,0,0.3", ["column 5 (amplitude_um): 'nan' is not a finite number"]),
        ("baseline,1500,X,1,inf,0,0.3", ["column 5 (amplitude_um): 'inf'"]),
        ("baseline,1500,X,1,1_0,0,0.3", ["'1_0' is not a finite number"]),
        ("baseline,1500,X,1,-1.0,0,0.3", ["column 5 (amplitude_um): -1 must be at least 0"]),
        ("baseline,0,X,1,1.0,0,0.3", ["column 2 (speed_rpm): 0 must be above 0"]),
        ("baseline,-5,X,1,1.0,0,0.3", ["column 2 (speed_rpm): -5 must be above 0"]),
        ("baseline,1500,X,1,1.0,0,0", ["column 7 (sigma_um): 0 must be above 0"]),
        ("baseline,1500,X,1,1.0,0,", ["column 7 (sigma_um): '' is not a finite number"]),
        ("baseline,1500,X,0,1.0,45,0.3", ["column 6 (phase_deg): order 0", "0 or 180"]),
        ("baseline,1500,X,-1,1.0,45,0.3", ["column 4 (order): -1 must be at least 0"]),
        ("baseline,1500,Z,1,1.0,0,0.3", ["column 3 (probe): unknown probe 'Z'; the rig file has X, Y"]),
        ("baseline,1500,X,1,1.0,0", ["data.csv:2: 6 cells, the header has 7"]),
        ("baseline,1500,X,1,1.0,0,0.3,9", ["data.csv:2: 8 cells, the header has 7"]),
        (",1500,X,1,1.0,0,0.3", ["column 1 (run): empty"]),
        (
            "baselin,1500,X,1,1.0,0,0.3",
            [
                "data.csv:2: run 'baselin' is not in",
                "did you mean 'baseline'?",
                "[runs.baselin]",
                "magnitude_g_mm = 0.0",
            ],
        ),
    ],
)
def test_refused_rows(tmp_path, row, words):
    text = problems(tmp_path, f"{HEADER}\n{row}\n")
    for word in words:
        assert word in text


def test_all_problems_at_once(tmp_path):
    text = problems(tmp_path, f"{HEADER}\nbaseline,x,X,1,1.0,0,0.3\nbaseline,1500,Q,1,-1,0,0.3\n")
    assert len(text.splitlines()) == 3
    assert "data.csv:2:" in text
    assert "data.csv:3:" in text


def test_duplicates(tmp_path):
    text = problems(tmp_path, f"{HEADER}\n{ROWS[0]}\n{ROWS[1]}\n{ROWS[0]}\n")
    assert "data.csv:4: same run, speed, probe and order as line 2" in text
    assert "repeat" in text


def test_repeats_give_the_pure_error(tmp_path):
    header = HEADER.replace("sigma_um", "repeat")
    rows = [
        f"baseline,1500,{probe},1,{amplitude},0,{k}" for probe in "XY" for k, amplitude in enumerate((10.0, 10.2, 9.8))
    ]
    m = read(tmp_path, "\n".join([header, *rows]))
    assert m.noise == "repeats"
    assert m.sigma[0, 0, 0] == pytest.approx(1e-6 * np.sqrt((0.04 + 0.04) * 2 / 8))


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("", "the file is empty"),
        (HEADER + "\n", "no rows below the header"),
        ("baseline,1500,X,1,1.0,0,0.3\n", "no header"),
        (HEADER.replace("phase_deg,", "") + "\nbaseline,1500,X,1,1.0,0.3\n", "column 'phase_deg' is missing"),
        (HEADER.replace("sigma_um", "sigma") + "\n" + BODY, "column 7 ('sigma') is unknown; did you mean 'sigma_um'?"),
        (HEADER.replace("phase_deg", "phase") + "\n" + BODY, "did you mean 'phase_deg'?"),
        (HEADER.replace("sigma_um", "run") + "\n" + BODY, "column 'run' appears 2 times"),
        ((HEADER + "\n" + BODY).encode("utf-16"), "UTF-16"),
        ((HEADER + "\n").encode() + b"\xe4,1500,X,1,1,0,0.3\n", "data.csv:2: not UTF-8"),
        (b"PK\x03\x04\x00\x00binary", "not a text file"),
    ],
)
def test_refused_files(tmp_path, table, words):
    assert words in problems(tmp_path, table)


def test_missing_file(tmp_path):
    _, toml = write(tmp_path)
    with pytest.raises(InputError, match="No such file"):
        read_measurement(tmp_path / "none.csv", read_rig(toml))


def test_conventions(tmp_path):
    from helpers import RIG

    m = read(tmp_path, f"{HEADER}\n{BODY}", RIG + '[convention]\namplitude = "peak-to-peak"\nphase = "lag"\n')
    assert m.vectors[0, 0, 0] == pytest.approx(19.93e-6 / 2 * np.exp(1j * np.radians(31.4)))
    assert m.sigma[0, 0, 0] == pytest.approx(0.15e-6)


def test_written_and_read_again(tmp_path):
    from helpers import RIG

    data, toml = write(tmp_path, rig=RIG + '[convention]\namplitude = "peak-to-peak"\nphase = "lag"\n')
    rig = read_rig(toml)
    m = read_measurement(data, rig)
    rig.write_measurement(tmp_path / "again.csv", m)
    again = read_measurement(tmp_path / "again.csv", rig)
    np.testing.assert_allclose(again.vectors, m.vectors, rtol=1e-8)
    np.testing.assert_allclose(again.sigma, m.sigma, rtol=1e-8)
