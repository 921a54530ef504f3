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
        f"{HEADER}\n{BODY}".replace(",1,", ",1X,", 1).replace(",1,", ",1x,"),
    ],
    ids=["bom", "crlf", "blank lines", "blanks", "any order", "more columns", "semicolons and decimal commas", "1X"],
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
        ("baseline,1500,X,X,1.0,0,0.3", ["column 4 (order): 'X' is not a finite number"]),
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
        (HEADER.replace("phase_deg", "fase") + "\n", "column 'phase_deg' is missing (not read: 'fase')"),
        (HEADER.replace("sigma_um", "sigma") + "\n" + BODY, "column 7 ('sigma') is unknown; did you mean 'sigma_um'?"),
        (HEADER.replace("phase_deg", "phase") + "\n" + BODY, "did you mean 'phase_deg'?"),
        (HEADER.replace("sigma_um", "run") + "\n" + BODY, "column 'run' appears 2 times"),
        ((HEADER + "\n" + BODY).encode("utf-16"), "UTF-16"),
        ((HEADER + "\n").encode() + b"\xe4,1500,X,1,1,0,0.3\n", "data.csv:2: not UTF-8"),
        (
            HEADER + "\n" + BODY.replace(".", ","),
            "every row has more than the 7 cells of the header, as with decimal commas",
        ),
        (b"PK\x03\x04\x00\x00binary", "not a text file"),
    ],
)
def test_refused_files(tmp_path, table, words):
    assert words in problems(tmp_path, table)


@pytest.mark.parametrize(
    ("column", "written", "cure"),
    [
        ("amplitude_um", "amplitude_mil", "is in mils: multiply it by 25.4 (1 mil = 25.4 µm); then call the column"),
        ("amplitude_um", "Amplitude (mils pk-pk)", "is in mils: multiply it by 25.4 (1 mil = 25.4 µm), and is peak-to"),
        ("amplitude_um", "amplitude_mm", "is in millimetres: multiply it by 1000"),
        ("amplitude_um", "amplitude_um_pp", '[convention] amplitude = "peak-to-peak" in the rig file'),
        ("amplitude_um", "disp_um_rms", 'is an rms value: write [convention] amplitude = "rms"'),
        ("amplitude_um", "velocity_mm_s", "is a velocity: divide it by order × 2π × speed_rpm / 60"),
        ("phase_deg", "phase_rad", "is in radians: multiply it by 57.29578"),
        ("phase_deg", "Phase lag (deg)", '[convention] phase = "lag" in the rig file'),
        ("speed_rpm", "speed_hz", "multiply it by 60 (1 Hz = 60 rpm)"),
        ("speed_rpm", "omega_rad_s", "multiply it by 9.549297"),
        ("sigma_um", "sigma_mil", "multiply it by 25.4"),
        ("probe", "sensor", "is not a name that is read; call it 'probe'"),
    ],
)
def test_columns_in_other_units_are_refused_with_the_cure(tmp_path, column, written, cure):
    text = problems(tmp_path, f"{HEADER.replace(column, written)}\n{BODY}")
    assert len(text.splitlines()) == 1
    assert f"data.csv:1: column {HEADER.split(',').index(column) + 1} ({written!r}) {cure}" in text or cure in text
    assert f"{column!r}" in text


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda row: row.replace(",1500,", ",25,"), "every speed_rpm is below 200 rpm: if they are in Hz"),
        (lambda row: ",".join([*row.split(",")[:4], "0.0019", "0", "0.0001"]), "every amplitude_um is below 0.01 µm"),
    ],
)
def test_values_that_look_like_other_units_get_a_note_and_are_read_as_they_are(tmp_path, change, words):
    data, _ = write(tmp_path, table="\n".join([HEADER, *map(change, ROWS)]))
    table = read_table(data)
    assert not table.problems
    assert words in table.notes[0]
    assert table.rows[0].speed_rpm in {25.0, 1500.0}
    assert table.rows[0].amplitude_um in {0.0019, 19.93}


def test_phases_that_look_like_radians_get_a_note(tmp_path):
    rows = [f"baseline,{900 + 100 * k},X,1,20.0,{0.7 * k - 2.0},0.3" for k in range(6)]
    data, _ = write(tmp_path, table="\n".join([HEADER, *rows]))
    assert "if they are in radians multiply them by 57.29578" in read_table(data).notes[0]
    data, _ = write(tmp_path)
    assert read_table(data).notes == []


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            b"PK\x03\x04" + bytes(26) + b"[Content_Types].xml",
            "an Excel workbook (.xlsx), not a text file; save the sheet",
        ),
        (b"\xd0\xcf\x11\xe0\xa1\xb1", "an old Excel workbook (.xls), not a text file"),
        (b"PAR1\x15\x04", "a Parquet file, not a text file; export it as text"),
        (b"MATLAB 5.0 MAT-file, Platform: GLNXA64", "a MATLAB file (.mat), not a text file"),
        (b"\x89HDF\r\n\x1a\n", "an HDF5 file"),
        (b"\x1f\x8b\x08\x00", "compressed by gzip, not a text file; unpack it first"),
        (b"\x7fELF\x02\x01\x00", "a binary file (it holds zero bytes), not a text file"),
        (bytes(range(1, 256)), "a binary file, not a text file"),
        ((HEADER + "\n" + BODY).encode("utf-16-le"), "encoded as UTF-16 without a byte order mark; save it as UTF-8"),
        ((HEADER + "\n" + BODY).encode("utf-32"), "encoded as UTF-32; save it as UTF-8"),
    ],
)
def test_files_that_are_no_text_are_called_what_they_are(tmp_path, content, words):
    """As a table and as a rig file."""
    data, toml = write(tmp_path, table=content)
    for path, read_it in ((data, read_table), (toml, read_rig)):
        path.write_bytes(content)
        with pytest.raises(InputError) as caught:
            read_it(path)
        assert str(caught.value).startswith(f"{path}: {words}")
        assert len(caught.value.problems) == 1


def test_a_folder_is_called_that(tmp_path):
    for read_it in (read_table, read_rig):
        with pytest.raises(InputError, match="is a folder; give the path of a file in it"):
            read_it(tmp_path)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (f"{HEADER}\n{BODY}".replace("1500", '"1,500"'), "'1,500' is not a finite number; leave out the separator of"),
        (f"{HEADER}\n{BODY}".replace("1500", "1 500"), "'1 500' is not a finite number; leave out the separator of"),
        (f"{HEADER}\n{BODY}".replace("19.93", '"19,93"'), "'19,93' is not a finite number; write it like 12.5"),
        (f"{HEADER}\n{BODY}".replace("19.93", "1e400"), "'1e400' is not a finite number"),
        (f"{HEADER}\n{BODY}".replace("19.93", "1e300"), "1e+300 is beyond anything measured"),
        (f"{HEADER}\n{BODY}".replace(",1,", ",1e8,"), "column 4 (order): 1e+08 is above 100"),
        (f"{HEADER}\n{BODY}".replace("baseline,", '"baseline,', 1), "close the quotation mark"),
        (f"{HEADER}\n{BODY}".replace(",", "|"), "no header of several columns separated by commas"),
        (
            f"{HEADER}\n{BODY}".replace(",", ";").replace(".", ",").replace("1500", "1.500,0"),
            "leave out the separator of thousands; or save the table with commas between cells and decimal points",
        ),
        (
            f"{HEADER}\n{BODY}".replace(",", ";").replace(".", ",").replace("1500", "1.500"),
            "leave out the separator of thousands; or save the table with commas between cells and decimal points",
        ),
        ("[rotor]\nmass_kg = 1.0\n", "no header, but what looks like a rig file, which goes with --rig"),
    ],
)
def test_odd_tables_are_refused_with_the_cure(tmp_path, table, words):
    assert words in problems(tmp_path, table)


@pytest.mark.parametrize(
    "table",
    [
        f"{HEADER}\n{BODY}".replace("\n", "\r"),
        f"{HEADER}\n{BODY}".replace("\n", ",\n"),
        f"{HEADER}\n{BODY}".replace(",", "\t"),
        f"{HEADER}\n{BODY}".replace("-31.4", "688.6"),
    ],
    ids=["carriage returns", "trailing commas", "tabs", "phase beyond a turn"],
)
def test_odd_tables_that_are_read(tmp_path, table):
    m = read(tmp_path, table)
    assert m.vectors[0, 0, 0] == pytest.approx(19.93e-6 * np.exp(-1j * np.radians(31.4)))


def test_missing_file(tmp_path):
    _, toml = write(tmp_path)
    with pytest.raises(InputError, match="No such file"):
        read_measurement(tmp_path / "none.csv", read_rig(toml))


def test_conventions(tmp_path):
    from helpers import RIG

    m = read(tmp_path, f"{HEADER}\n{BODY}", RIG + '[convention]\namplitude = "peak-to-peak"\nphase = "lag"\n')
    assert m.vectors[0, 0, 0] == pytest.approx(19.93e-6 / 2 * np.exp(1j * np.radians(31.4)))
    assert m.sigma[0, 0, 0] == pytest.approx(0.15e-6)
    m = read(tmp_path, f"{HEADER}\n{BODY}", RIG + '[convention]\namplitude = "rms"\n')
    assert m.sigma[0, 0, 0] == pytest.approx(0.3e-6 * np.sqrt(2.0))
    assert m.vectors[0, 0, 0] == pytest.approx(19.93e-6 * np.sqrt(2.0) * np.exp(-1j * np.radians(31.4)))
    constant = "baseline,1500,X,0,19.93,180,0.3"
    still = read(tmp_path, f"{HEADER}\n{constant}\n", RIG + '[convention]\namplitude = "rms"\n')
    assert still.vectors[0, 0, 0] == pytest.approx(-19.93e-6)


@pytest.mark.parametrize("amplitude", ["peak-to-peak", "rms"])
def test_written_and_read_again(tmp_path, amplitude):
    from helpers import RIG

    table = "\n".join([HEADER, *ROWS, "baseline,1500,X,0,7.5,180,0.3"]) + "\n"
    data, toml = write(tmp_path, table=table, rig=RIG + f'[convention]\namplitude = "{amplitude}"\nphase = "lag"\n')
    rig = read_rig(toml)
    m = read_measurement(data, rig)
    rig.write_measurement(tmp_path / "again.csv", m)
    again = read_measurement(tmp_path / "again.csv", rig)
    np.testing.assert_allclose(again.vectors, m.vectors, rtol=1e-8)
    np.testing.assert_allclose(again.sigma, m.sigma, rtol=1e-8)
