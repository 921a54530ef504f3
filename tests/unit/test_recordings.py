"""Recordings in every format give the same vectors; what cannot be used is refused with file, channel and cure."""

import json
import sys
import tracemalloc

import numpy as np
import pytest
from scipy.io import savemat, wavfile

from rotorjax.cli import main
from rotorjax.data import record_points, recording_formats, recordings
from rotorjax.data.record_vectors import read_recordings
from rotorjax.data.recordings import open_recording
from rotorjax.data.rig import read_rig
from rotorjax.errors import InputError

from recorded import RATE, SAG, TWICE, Z, as_csv, made, rig_file

NO_TIME = f"[waveform]\nsample_rate_hz = {RATE}\n"


@pytest.fixture
def record(rng):
    return made(rng)


def refused(rig_path) -> str:
    with pytest.raises(InputError) as error:
        read_recordings(read_rig(rig_path))
    return str(error.value)


def columns(record) -> dict[str, np.ndarray]:
    return {"reference": record.reference, "X": record.waves[:, 0] * 1e6, "Y": record.waves[:, 1] * 1e6}


def write_npz(path, record):
    np.savez_compressed(path, **columns(record), note=np.array(3.0))
    return NO_TIME


def write_matrix(path, record):
    np.savez(path, data=np.column_stack(list(columns(record).values())))
    return NO_TIME + ('reference = { channel = "data[0]" }\nX = { channel = "data[1]" }\nY = { channel = 2 }\n')


def write_mat(path, record):
    savemat(path, {**{k: v[:, None] for k, v in columns(record).items()}, "name": "a text"})
    return NO_TIME


def write_wav(path, record):
    full = np.column_stack([record.reference / 10.0, record.waves / 200e-6])
    wavfile.write(path, int(RATE), np.round(full * 2**31).astype(np.int32))
    return (
        "[waveform]\nreference = { channel = 0 }\nX = { channel = 1, scale = 200.0 }\n"
        'Y = { channel = 2, unit = "V", sensitivity_mv_per_um = 8.0, scale = 1.6 }\n'
    )


def write_semicolons(path, record):
    lines = [
        ";".join(f"{value:.6f}".replace(".", ",") for value in row)
        for row in zip(*columns(record).values(), strict=True)
    ]
    path.write_text("# a comment\nreference;X;Y\n" + "\n".join(lines), encoding="utf-8")
    return NO_TIME


def write_hdf5(path, record):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        for name, values in columns(record).items():
            file[f"probes/{name}"] = values
    return NO_TIME + "".join(f'{name} = {{ channel = "probes/{name}" }}\n' for name in ("reference", "X", "Y"))


def write_matlab_7_3(path, record):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        file["data"] = np.stack(list(columns(record).values()))  # MATLAB stores a sample x channel matrix turned
        file["data"].attrs["MATLAB_class"] = np.bytes_("double")
    return NO_TIME + "reference = { channel = 0 }\n" + 'X = { channel = "data[1]" }\nY = { channel = "data[2]" }\n'


def write_tdms(path, record):
    nptdms = pytest.importorskip("nptdms")
    channels = [
        nptdms.ChannelObject("rig", name, values, properties={"wf_increment": 1.0 / RATE})
        for name, values in columns(record).items()
    ]
    with nptdms.TdmsWriter(str(path)) as writer:
        writer.write_segment(channels)
    return ""


def write_uff(path, record):
    pyuff = pytest.importorskip("pyuff")
    file = pyuff.UFF(str(path))
    for name, values in columns(record).items():
        file.write_sets(
            pyuff.prepare_58(
                func_type=1, rsp_node=1, rsp_dir=1, ref_node=0, ref_dir=0, data=values, x=record.time, id1=name,
                binary=0, abscissa_spacing=1, ordinate_spec_data_type=8, abscissa_spec_data_type=17,
                ver_num=0, load_case_id=0, rsp_ent_name="NONE", ref_ent_name="NONE", orddenom_spec_data_type=0,
                z_axis_spec_data_type=0,
            ),
            mode="add",
        )  # fmt: skip
    return ""


WRITERS = {
    "a.csv": lambda path, record: as_csv(record, path) and "", "b.txt": write_semicolons, "c.npz": write_npz,
    "d.npz": write_matrix, "e.mat": write_mat, "f.wav": write_wav, "g.h5": write_hdf5, "h.mat": write_matlab_7_3,
    "i.tdms": write_tdms, "j.uff": write_uff,
}  # fmt: skip


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
@pytest.mark.parametrize("name", WRITERS)
def test_every_format_gives_the_vectors_recorded(tmp_path, record, name, monkeypatch):
    waveform = WRITERS[name](tmp_path / name, record)
    rig = read_rig(rig_file(tmp_path, f"{name}=baseline", waveform))
    found = read_recordings(rig, orders=(0.0, 1.0, 2.0)).records[0]
    point = found.points[0]
    truth = np.array([[SAG, z, TWICE * z] for z in Z.values()])
    np.testing.assert_allclose(point.vectors[:, 1], truth[:, 1], rtol=2e-4)
    np.testing.assert_allclose(point.vectors, truth, atol=2e-8)
    assert point.speed_rpm == pytest.approx(1500.0, rel=1e-5)
    for module in (recordings, recording_formats, record_points):
        monkeypatch.setattr(module, "PIECE", 1000)
    again = read_recordings(rig, orders=(0.0, 1.0, 2.0)).records[0].points[0]
    np.testing.assert_allclose(again.vectors, point.vectors, atol=1e-8)
    assert again.revolutions == point.revolutions


@pytest.mark.parametrize(("name", "package"), [("g.h5", "h5py"), ("i.tdms", "nptdms"), ("j.uff", "pyuff")])
def test_a_missing_package_is_named_with_its_extra(tmp_path, name, package, monkeypatch):
    begin = {"g.h5": b"\x89HDF\r\n\x1a\n", "i.tdms": b"TDSm", "j.uff": b"    -1\n    58\n"}[name]
    (tmp_path / name).write_bytes(begin + bytes(600))
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(InputError, match=r"not installed: pip install 'rotorjax\[formats\]'"):
        open_recording(tmp_path / name)


def test_no_pickle_is_opened(tmp_path, record):
    np.savez(tmp_path / "a.npz", **columns(record), evil=np.array([{"a": 1}], dtype=object))
    assert open_recording(tmp_path / "a.npz").names == ("reference", "X", "Y")
    np.savez(tmp_path / "b.npz", X=np.array([{"a": 1}], dtype=object))
    with pytest.raises(InputError, match="holds no channel of numbers"):
        open_recording(tmp_path / "b.npz")


def test_a_long_recording_takes_little_memory(tmp_path, rng, monkeypatch):
    long = made(rng, seconds=20.0)
    np.savez(tmp_path / "a.npz", **columns(long))
    rig = read_rig(rig_file(tmp_path, "a.npz=baseline", NO_TIME))
    for module in (recordings, recording_formats, record_points):
        monkeypatch.setattr(module, "PIECE", 2**12)
    tracemalloc.start()
    found = read_recordings(rig).records[0].points[0]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found.revolutions == 499
    assert peak < 0.6 * 3 * long.time.nbytes


# Refusals


def stuck(record):
    record.waves[:, 1] = 3e-6


def clipped(record):
    np.clip(record.waves, -100e-6, None, out=record.waves)


def gap(record):
    record.waves[2000:2040, 0] = np.nan


def silent(record):
    record.reference[:] = 0.02


def short(record):
    record.reference[400:] = 0.0


def doubled(record):
    record.reference[:] = 5.0 * ((np.arange(len(record.time)) % 64) < 9)


def lost(record):
    record.reference[2000:4000] = 0.0


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (stuck, ["a.csv: channel 'Y' (probe Y) is constant at 3", "connected"]),
        (clipped, ["a.csv: channel 'X' (probe X) is clipped", "widen the range"]),
        (gap, ["a.csv: channel 'X' (probe X) has a gap: no number at t = 0.3125 s, 40 such samples", "cut the record"]),
        (silent, ["a.csv: channel 'reference' (phase reference): the reference channel is constant", "connected"]),
        (short, ["a.csv: a record must hold at least 2 whole revolutions", "record longer"]),
        (lost, ["channel 'reference' (phase reference): pulses must come once per revolution", "cut the record there"]),
    ],
)
def test_channels_that_cannot_be_used(tmp_path, record, spoil, words, capsys):
    spoil(record)
    as_csv(record, tmp_path / "a.csv")
    rig = rig_file(tmp_path, "a.csv=baseline")
    assert main(["vectors", str(rig), "--output", str(tmp_path / "out.csv")]) == 2
    said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("rotorjax:")]
    assert len(said) == 1
    assert all(word in said[0] for word in words), said
    assert not (tmp_path / "out.csv").exists()


def test_pulses_at_the_wrong_rate(tmp_path, record):
    doubled(record)
    as_csv(record, tmp_path / "a.csv")
    rig = rig_file(tmp_path, "a.csv=baseline")
    rig.write_text(rig.read_text().replace('run = "baseline"', 'run = "baseline"\nspeed_rpm = 1500'))
    assert "its pulses come at 6000 rpm, a.csv is said to have 1500 rpm; does the reference see 4 marks" in refused(rig)


def test_twice_per_turn_is_suspected(tmp_path, rng):
    """Marks half a turn apart: what was 1X is then a half order."""
    record = made(rng)
    turned = 2 * np.pi * 25.0 * record.time - 1.0
    record.reference[:] = 5.0 * (np.abs((turned + 0.3) % np.pi) < 0.6)
    record.waves[:] = np.real(np.array(list(Z.values())) * np.exp(1j * turned)[:, None])
    as_csv(record, tmp_path / "a.csv")
    notes = read_recordings(read_rig(rig_file(tmp_path, "a.csv=baseline"))).records[0].notes
    assert "the reference fires twice per turn" in notes[0]


def test_pulses_are_mended_and_said(tmp_path, rng):
    """Two pulses are wiped out, a spurious one comes late in a turn: the vectors are those of the whole record."""
    record, turn = made(rng, seconds=2.0), int(RATE / 25)
    record.reference[5 * turn : 6 * turn] = 0.0
    record.reference[15 * turn : 16 * turn] = 0.0
    at = int(np.argmax(record.reference[20 * turn :] > 4.0)) + 20 * turn + int(0.8 * turn)
    record.reference[at : at + 12] = 5.0
    as_csv(record, tmp_path / "a.csv")
    found = read_recordings(read_rig(rig_file(tmp_path, "a.csv=baseline"))).records[0]
    np.testing.assert_allclose(found.points[0].vectors[:, 0], list(Z.values()), rtol=2e-4)
    assert [line.split(":")[1].split(" (")[0] for line in found.notes] == [
        " 2 of 50 pulses missing, put in between its neighbours", " 1 of 50 pulses too many, left out",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("waveform", "words"),
    [
        ('[waveform]\nX = { channel = "chan" }\nY = { channel = "Y" }\n', "no channel 'chan'"),
        ('[waveform]\nX = { channel = 9 }\nY = { channel = "Y" }\n', "no channel 9; it has 4, counted from 0"),
        ('[waveform]\nX = { channel = "Y" }\nY = { channel = "Y" }\n', "'Y' is to be probe Y and probe X"),
        ("[waveform]\norders = [1, 130]\n", "no order is above 100"),
        ("[waveform]\nsample_rate_hz = 3200\n", "'time_s' (time) rises as at 6400 Hz, where 3200 Hz is stated; leave"),
        ('[waveform]\ntime = "seconds"\n', "no channel 'seconds'"),
        ('[waveform]\nslow_roll = "slow.csv"\n', "slow.csv: No such file"),
        ("[waveform]\nslow_roll = 3\n", "must be the name of a recording"),
        ("[waveform]\norders = 1\n", "must be a list of multiples"),
        ("[waveform]\nX = { channel = 2, scale = 0.0 }\n", "scale: must not be zero"),
    ],
)
def test_what_the_rig_file_says_must_fit(tmp_path, record, waveform, words):
    as_csv(record, tmp_path / "a.csv")
    assert words in refused(rig_file(tmp_path, "a.csv=baseline", waveform))


def test_files_that_cannot_be_used(tmp_path, record, rng):
    as_csv(made(rng, rate=200.0), tmp_path / "slow.csv")
    assert "order 5 needs more than 10 samples per revolution; the record has 8" in refused(
        rig_file(tmp_path, "slow.csv=baseline", "[waveform]\norders = [1, 5]\n")
    )
    data = columns(record)
    np.savez(tmp_path / "a.npz", reference=data["reference"], X=data["X"][:-7], Y=data["Y"])
    assert "channels of differing lengths (reference 6400, X 6393, Y 6400 samples)" in refused(
        rig_file(tmp_path, "a.npz=baseline", NO_TIME)
    )
    write_npz(tmp_path / "b.npz", record)
    assert "nothing says how fast it was sampled; state sample_rate_hz" in refused(rig_file(tmp_path, "b.npz=baseline"))
    waveform = write_wav(tmp_path / "c.wav", record)
    assert "holds shares of its full scale; state that in um as scale" in refused(
        rig_file(tmp_path, "c.wav=baseline", waveform.replace(", scale = 200.0", ""))
    )
    assert "sampled at 6400 Hz by its own account, at 9000 Hz by sample_rate_hz" in refused(
        rig_file(tmp_path, "c.wav=baseline", waveform.replace("[waveform]", "[waveform]\nsample_rate_hz = 9000"))
    )
    coarse = record._replace(time=np.round(record.time, 3))
    as_csv(coarse, tmp_path / "d.csv")
    assert "channel 'time_s' (time) does not rise" in refused(rig_file(tmp_path, "d.csv=baseline"))
    torn = record._replace(time=record.time + (record.time > 0.5))
    as_csv(torn, tmp_path / "e.csv")
    assert "(time) has a gap before t = 1.5" in refused(rig_file(tmp_path, "e.csv=baseline"))
    lines = as_csv(record, tmp_path / "f.csv").read_text().splitlines()
    (tmp_path / "f.csv").write_text("\n".join([*lines[:50], "0.1,over,1,2", *lines[51:]]))
    assert "f.csv:51: channel 'reference': 'over' is not a number" in refused(rig_file(tmp_path, "f.csv=baseline"))
    for name, content in (("g.csv", b""), ("h.npz", b"PK\x03\x04"), ("i.wav", b"RIFF1234WAVE"), ("j.mat", b"no"),
                          ("k.csv", b"\xff\xfe\x00\x01"), ("l.wav", bytes(200_000))):  # fmt: skip
        (tmp_path / name).write_bytes(content)
        assert name in refused(rig_file(tmp_path, f"{name}=baseline"))


def test_rows_of_another_width_are_refused_and_empty_cells_at_their_end_are_none(tmp_path, record):
    """Decimal commas between commas, or one cell too many, would shift the columns."""
    lines = as_csv(record, tmp_path / "a.csv").read_text().splitlines()
    rig = rig_file(tmp_path, "a.csv=baseline")
    commas = "a.csv:51: 8 cells, the first line has 4; cut the record before this line, or mend it; decimal commas take"
    for row, words in (
        (lines[50].replace(",", ",0,"), "a.csv:51: 7 cells, the first line has 4"),
        (lines[50].replace(".", ","), commas),
        (lines[50].rpartition(",")[0], "a.csv:51: 3 cells, the first line has 4"),
    ):
        (tmp_path / "a.csv").write_text("\n".join([*lines[:50], row, *lines[51:]]))
        assert words in refused(rig)
    for header, end in ((",", ""), ("", ", ,"), (",note", ",")):
        (tmp_path / "a.csv").write_text("\n".join([lines[0] + header, *(line + end for line in lines[1:])]))
        point = read_recordings(read_rig(rig)).records[0].points[0]
        np.testing.assert_allclose(point.vectors[:, 0], list(Z.values()), rtol=2e-4)


def write_packed_hdf5(path, record):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        for name, values in columns(record).items():
            file.create_dataset(name, data=values, compression="gzip")


def flipped(content: bytes) -> bytes:
    half = len(content) // 2
    return content[:half] + bytes([content[half] ^ 0xFF]) + content[half + 1 :]


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
@pytest.mark.parametrize(
    ("name", "write", "spoil"),
    [
        ("a.npz", write_npz, flipped),
        ("a.wav", write_wav, lambda content: content[:-101]),
        ("a.wav", write_wav, lambda content: content[:30]),
        ("a.h5", write_packed_hdf5, flipped),
        ("a.tdms", write_tdms, lambda content: content[:25] + b"\xff" + content[26:]),
        ("a.uff", write_uff, flipped),
    ],
)
def test_a_damaged_file_is_refused_in_one_message(tmp_path, record, name, write, spoil, capsys):
    waveform = write(tmp_path / name, record) or NO_TIME
    (tmp_path / name).write_bytes(spoil((tmp_path / name).read_bytes()))
    rig = rig_file(tmp_path, f"{name}=baseline", waveform)
    assert main(["vectors", str(rig), "--output", str(tmp_path / "out.csv")]) == 2
    said = capsys.readouterr().err.splitlines()
    assert said[-1].startswith(f"rotorjax: {tmp_path / name}: cannot be read (")
    assert said[-1].endswith("; export it anew")
    assert not (tmp_path / "out.csv").exists()


@pytest.mark.parametrize("name", ["i.tdms", "j.uff"])
def test_a_file_that_breaks_off_while_it_is_read_is_refused(tmp_path, record, name):
    WRITERS[name](tmp_path / name, record)
    found = open_recording(tmp_path / name)
    (tmp_path / name).write_bytes(b"TDSm" if name == "i.tdms" else b"    -1\n    58\n")
    with pytest.raises(InputError, match=f"{name}: cannot be read"):
        list(found.together([0]))


# The command line


def test_vectors_then_explain_and_explain_at_once(tmp_path, capsys):
    """The example's recordings hide 9 g mm at 50 degrees and a cross-coupling of 1200 N/m."""
    assert main(["example", str(tmp_path / "demo"), "--recordings"]) == 0
    rig, table = tmp_path / "demo" / "rig.toml", tmp_path / "demo" / "m.csv"
    assert main(["vectors", str(rig), "--output", str(table)]) == 0
    assert "48 vectors of 24 recordings" in capsys.readouterr().out
    files = sorted((tmp_path / "demo" / "recordings").glob("trial-a-*.csv"))
    again = tmp_path / "again.csv"
    assert main(["vectors", *map(str, files), "--rig", str(rig), "--orders", "1,2", "--output", str(again)]) == 0
    assert len(again.read_text().splitlines()) == 1 + 8 * 2 * 2
    result = tmp_path / "r.json"
    effects = "residual_unbalance,cross_coupling"
    assert main(["explain", "--recordings", str(rig), "--only", effects, "--json", str(result)]) == 0
    told = json.loads(result.read_text())
    assert told["verdict"] == "explained"
    assert set(told["effects"]) == {"residual_unbalance", "cross_coupling"}
    cross = told["steps"][-1]["parameters"]["cross_coupling"]["cross_stiffness_n_per_m"]
    assert cross["value"] == pytest.approx(1200.0, abs=3.0 * cross["standard_error"])
    for inputs in ([str(table), "--rig", str(rig)], ["--recordings", str(rig)]):
        capsys.readouterr()
        assert main(["diagnose", *inputs]) == 0
        assert "baseline                9.1 ± 0.6     46.8 ± 3.6" in capsys.readouterr().out
        assert main(["compare", *inputs]) == 0
        assert "differs from the measurement by 38.4 µm rms" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["explain"], "give a table and its rig file"),
        (["compare", "a.csv"], "give a table and its rig file"),
        (["diagnose", "--rig", "rig.toml", "--recordings", "rig.toml"], "leave one of the two out"),
        (["explain", "a.csv", "--recordings", "rig.toml"], "leave one of the two out"),
        (["vectors", "--output", "o.csv"], "name the rig file alone"),
        (["vectors", "a.csv", "b.csv", "--output", "o.csv"], "name the rig file alone"),
        (["vectors", "rig.toml", "--output", "rig.toml"], "is read by the same command"),
        (["vectors", "rig.toml", "--sample-rate", "-3", "--output", "o.csv"], "--sample-rate -3.0"),
        (["vectors", "rig.toml", "--orders", "x", "--output", "o.csv"], "--orders x"),
        (["vectors", "rig.toml", "--output", "o.csv"], "names no recordings"),
        (["vectors", "full.toml", "--output", "c.csv"], "--output c.csv: is one of the recordings"),
        (["explain", "--recordings", "full.toml", "--json", "c.csv"], "--json c.csv: is one of the recordings"),
        (["vectors", "c.csv", "--rig", "rig.toml", "--output", "o.csv"], "does not say which run it holds"),
    ],
)
def test_command_lines_that_say_too_little(tmp_path, arguments, words, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rig_file(tmp_path, "c.csv=baseline").rename(tmp_path / "full.toml")
    rig_file(tmp_path, "")
    assert main(arguments) == 2
    assert words in capsys.readouterr().err
