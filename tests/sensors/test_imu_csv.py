"""Inertial CSV as the world writes it: dialects give the same samples, faults are named with their row."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from smts_validate.sensors.formats import imu_csv, steer_csv
from smts_validate.sensors.manifest import Imd, Steer, Units
from smts_validate.sensors.raw import RawError, RawImu

DATE = dt.date(2025, 5, 14)
HEADER = "t_host_ns,t_dev_us,seq,ax,ay,az,gx,gy,gz,mx,my,mz"
START = 1_747_216_800_123_456_789
N = 200
REST = (0.0, 0.0, 9.81, 0.0, 0.0, 0.0, 2.0, 0.0, -4.0)


def unit(**changes: object) -> Imd:
    return Imd.model_validate(
        {"kind": "imd", "body": "tractor", "file": "imd1.csv", "position": [0, 0, 0], "rate": 100.0} | changes
    )


def numbers() -> NDArray[np.float64]:
    """(N, 9) values as a unit at rest gives them, five digits."""
    rng = np.random.default_rng(0)
    values = np.round(rng.normal(REST, 0.1, (N, 9)), 5)
    return values * np.repeat([1.0, 1e-5], [6, 3])


def rows() -> list[list[str]]:
    """Cells of each row."""
    return [
        [str(START + k * 10_000_000), str(1000 + k * 10_000), str(k), *(repr(float(x)) for x in value)]
        for k, value in enumerate(numbers())
    ]


def table(cells: Sequence[Sequence[str]], header: str = HEADER, separator: str = ",", end: str = "\n") -> str:
    return end.join([header.replace(",", separator), *(separator.join(row) for row in cells)]) + end


def read(folder: Path, text: str | bytes, **changes: object) -> RawImu:
    path = folder / "imd1.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return imu_csv.read(path, unit(**changes), "imd1", DATE)


def with_cell(row: int, column: str, value: str) -> str:
    """The table with one cell changed; row 2 is the first below the header."""
    cells = rows()
    cells[row - 2][HEADER.split(",").index(column)] = value
    return table(cells)


def assert_whole(raw: RawImu) -> None:
    expected = numbers()
    assert raw.host_ns.tolist() == [START + k * 10_000_000 for k in range(N)]
    assert raw.counter is not None
    assert raw.seq is not None
    assert raw.magnetic_field is not None
    assert np.array_equal(raw.counter, 1000 + 10_000 * np.arange(N))
    assert np.array_equal(raw.seq, np.arange(N))
    assert raw.specific_force == pytest.approx(expected[:, :3], abs=1e-12)
    assert raw.angular_velocity == pytest.approx(expected[:, 3:6], abs=1e-12)
    assert raw.magnetic_field == pytest.approx(expected[:, 6:], abs=1e-12)
    assert raw.rows.tolist() == list(range(raw.rows[0], raw.rows[0] + N))


def decimal_commas() -> str:
    cells = [[cell.replace(".", ",") for cell in row] for row in rows()]
    return table(cells, separator=";")


DIALECTS: dict[str, Callable[[], str | bytes]] = {
    "plain": lambda: table(rows()),
    "CRLF": lambda: table(rows(), end="\r\n"),
    "byte order mark": lambda: b"\xef\xbb\xbf" + table(rows()).encode(),
    "UTF-16 little endian": lambda: b"\xff\xfe" + table(rows()).encode("utf-16-le"),
    "UTF-16 big endian": lambda: b"\xfe\xff" + table(rows()).encode("utf-16-be"),
    "UTF-16 without mark": lambda: table(rows()).encode("utf-16-le"),
    "sep= line": lambda: "sep=,\n" + table(rows()),
    "sep=; line": lambda: "sep=;\r\n" + table(rows(), separator=";", end="\r\n"),
    "semicolons": lambda: table(rows(), separator=";"),
    "tabs": lambda: table(rows(), separator="\t"),
    "decimal commas": decimal_commas,
    "trailing commas in rows": lambda: table([[*row, ""] for row in rows()]),
    "trailing commas everywhere": lambda: table([[*row, ""] for row in rows()], header=HEADER + ","),
    "trailing comma in the header": lambda: table(rows(), header=HEADER + ","),
    "quoted header": lambda: table(rows(), header=",".join(f'"{name}"' for name in HEADER.split(","))),
    "everything quoted": lambda: table([[f'"{cell}"' for cell in row] for row in rows()]),
    "blank lines at the end": lambda: table(rows()) + "\n\n",
    "spaces after commas": lambda: table(rows(), header=HEADER.replace(",", ", "), separator=","),
    "preamble": lambda: "Logger 3000\nfirmware,1.2\n\n" + table(rows()),
    "other columns between": lambda: table(
        [[*row[:3], "x", *row[3:], "y"] for row in rows()],
        header=HEADER.replace("seq,", "seq,comment,") + ",more",
    ),
}


@pytest.mark.parametrize("dialect", DIALECTS)
def test_every_dialect_gives_the_same_samples(tmp_path: Path, dialect: str) -> None:
    raw = read(tmp_path, DIALECTS[dialect]())
    assert_whole(raw)
    assert raw.warnings == ()


def test_units_are_converted(tmp_path: Path) -> None:
    raw = read(tmp_path, table(rows()), units={"accel": "g", "gyro": "deg/s", "mag": "uT"})
    assert raw.specific_force == pytest.approx(numbers()[:, :3] * 9.80665)
    assert raw.angular_velocity == pytest.approx(np.radians(numbers()[:, 3:6]))
    assert raw.magnetic_field == pytest.approx(numbers()[:, 6:] * 1e-6)


def test_a_renamed_time_column_keeps_its_unit_unless_units_says_otherwise(tmp_path: Path) -> None:
    text = table(rows(), header=HEADER.replace("t_host_ns", "time").replace("t_dev_us", "ticks"))
    columns = {"t_host_ns": "time", "t_dev_us": "ticks"}
    raw = read(tmp_path, text, columns=columns)
    assert_whole(raw)
    assert raw.tick == 1e-6
    raw = read(tmp_path, text, columns=columns, units={"device_time": "ms"})
    assert raw.tick == 1e-3


def test_host_times_in_fractional_seconds_are_read(tmp_path: Path) -> None:
    cells = [[f"{int(row[0]) / 1e9:.6f}", *row[1:]] for row in rows()]
    raw = read(tmp_path, table(cells), units={"host_time": "s"})
    expected = START + 10_000_000 * np.arange(N)
    assert np.abs(raw.host_ns - expected).max() < 1000


def test_times_in_another_unit_than_stated_are_refused_with_the_likely_one(tmp_path: Path) -> None:
    cells = [[str(int(row[0]) // 1_000_000), *row[1:]] for row in rows()]
    with pytest.raises(RawError, match=r'look like ms, not ns: set units = \{ host_time = "ms" \}'):
        read(tmp_path, table(cells))


@pytest.mark.parametrize(
    "value", ["", "nan", "NaN", "inf", "-Infinity", "abc", "1e34", "12..5", "--1", "1e400"]
)
def test_a_value_that_is_no_reading_drops_its_row_with_a_warning(tmp_path: Path, value: str) -> None:
    raw = read(tmp_path, with_cell(57, "gy", value))
    assert raw.host_ns.size == N - 1
    assert 57 not in raw.rows
    assert [(w.row, w.file, w.sensor, w.effect) for w in raw.warnings] == [
        (57, "imd1.csv", "imd1", "dropped")
    ]
    assert raw.warnings[0].what.startswith("1 row ")


@pytest.mark.parametrize("column", ["t_host_ns", "t_dev_us", "seq"])
@pytest.mark.parametrize("value", ["", "nan", "x", "-", "99999999999999999999999"])
def test_a_time_that_is_none_drops_its_row(tmp_path: Path, column: str, value: str) -> None:
    raw = read(tmp_path, with_cell(80, column, value))
    assert raw.host_ns.size == N - 1
    assert raw.warnings[0].row == 80
    assert raw.host_ns[0] == START  # the other times lose nothing


def test_a_host_time_far_from_its_neighbours_drops_its_row(tmp_path: Path) -> None:
    raw = read(tmp_path, with_cell(80, "t_host_ns", "12"))
    assert raw.host_ns.size == N - 1
    assert raw.warnings[0].row == 80


def test_a_counter_with_a_flipped_bit_drops_its_row(tmp_path: Path) -> None:
    raw = read(tmp_path, with_cell(80, "t_dev_us", str((1000 + 78 * 10_000) ^ 2**30)))
    assert raw.host_ns.size == N - 1
    assert raw.warnings[0].row == 80


def test_a_wrap_is_no_flipped_bit(tmp_path: Path) -> None:
    cells = rows()
    for k, row in enumerate(cells):
        row[1] = str((2**32 - 1_000_000 + k * 10_000) % 2**32)
    raw = read(tmp_path, table(cells))
    assert raw.host_ns.size == N
    assert raw.warnings == ()


@pytest.mark.parametrize(
    ("broken", "what"),
    [
        ("1,2,3", "with 3 cells instead of 12"),
        ("", "with an empty"),
        ("," * 20, "with 21 cells"),
    ],
)
def test_a_row_of_another_length_is_dropped_and_later_rows_keep_their_lines(
    tmp_path: Path, broken: str, what: str
) -> None:
    lines = table(rows()).splitlines()
    lines.insert(41, broken)  # line 42 of the file
    cells = lines[99].split(",")
    lines[99] = ",".join([*cells[:3], "oops", *cells[4:]])  # line 100
    raw = read(tmp_path, "\n".join(lines) + "\n")
    assert {w.row for w in raw.warnings} == {42, 100}
    assert any(what in w.what for w in raw.warnings)
    assert raw.host_ns.size == N - 1
    assert 42 not in raw.rows


def test_a_last_line_that_was_cut_off_is_dropped_even_if_it_looks_whole(tmp_path: Path) -> None:
    raw = read(tmp_path, table(rows())[:-3])
    assert raw.host_ns.size == N - 1
    assert [(w.row, "cut off" in w.what) for w in raw.warnings] == [(N + 1, True)]


def test_a_magnetometer_may_be_absent_or_empty(tmp_path: Path) -> None:
    short = ",".join(HEADER.split(",")[:9])
    assert read(tmp_path, table([row[:9] for row in rows()], header=short)).magnetic_field is None
    empty = [[*row[:9], "", "", ""] for row in rows()]
    assert read(tmp_path, table(empty)).magnetic_field is None
    some = [[*row[:9], "", "", ""] if k % 10 else row for k, row in enumerate(rows())]
    field = read(tmp_path, table(some)).magnetic_field
    assert field is not None
    assert np.isnan(field[:, 0]).sum() == N - N // 10


def test_rows_of_zeros_are_dropped(tmp_path: Path) -> None:
    cells = rows()
    for k in (5, 6, 90):
        cells[k][3:9] = ["0"] * 6
    raw = read(tmp_path, table(cells))
    assert raw.host_ns.size == N - 3
    assert raw.warnings[0].what == "3 rows with zero on every axis"
    assert raw.warnings[0].row == 7


def test_a_frozen_unit_is_dropped_from_its_second_row_on(tmp_path: Path) -> None:
    cells = (rows() * 4)[:600]
    for k, row in enumerate(cells):
        row = cells[k] = list(row)
        row[:3] = [str(START + k * 10_000_000), str(k * 10_000), str(k)]
        if 300 <= k < 450:
            row[3:9] = cells[299][3:9]
    raw = read(tmp_path, table(cells))
    assert raw.host_ns.size == 450
    assert raw.warnings[0].what == "150 rows that repeat one reading (the unit froze)"
    assert raw.warnings[0].row == 302


def swinging(gy: NDArray[np.float64]) -> str:
    """The table of a unit that swings about y, without magnetometer."""
    rng = np.random.default_rng(1)
    values = rng.normal(REST[:6], 0.1, (gy.size, 6))
    values[:, 4] = gy
    cells = [
        [str(START + k * 10_000_000), str(k * 10_000), str(k), *(f"{x:.5f}" for x in value)]
        for k, value in enumerate(values.tolist())
    ]
    return table(cells, header=",".join(HEADER.split(",")[:9]))


def test_a_saturated_axis_is_kept_but_named(tmp_path: Path) -> None:
    swing = 6.0 * np.sin(np.arange(2000) / 100.0)
    raw = read(tmp_path, swinging(np.clip(swing, -4.36, 4.36)))
    assert raw.host_ns.size == 2000
    named = [w for w in raw.warnings if "saturated" in w.what]
    assert len(named) == 1
    assert "gy at its extreme 4.36" in named[0].what
    assert named[0].row == 2 + int(np.argmax(np.abs(swing) >= 4.36))


def test_an_unsaturated_swing_is_not_called_saturated(tmp_path: Path) -> None:
    raw = read(tmp_path, swinging(6.0 * np.sin(np.arange(2000) / 100.0)))
    assert raw.warnings == ()


def test_a_column_that_turns_to_text_half_way_is_refused_with_its_row(tmp_path: Path) -> None:
    cells = [row if k < 90 else [*row[:5], "n/c", *row[6:]] for k, row in enumerate(rows())]
    with pytest.raises(
        RawError, match=r"imd1\.csv, row 92: 110 rows with an empty or non-numeric value of 200"
    ):
        read(tmp_path, table(cells))


def test_a_missing_column_is_named_with_the_way_to_mend_it(tmp_path: Path) -> None:
    with pytest.raises(RawError, match=r"row 1: no column 'gz' .* name it in `columns = \{ gz ="):
        read(tmp_path, table(rows(), header=HEADER.replace("gz", "GyrZ")))


def test_a_column_given_in_the_manifest_must_exist(tmp_path: Path) -> None:
    with pytest.raises(RawError, match=r"no column 'AccX', which `columns` of run\.toml gives for ax"):
        read(tmp_path, table(rows()), columns={"ax": "AccX"})


def test_two_columns_of_one_name_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RawError, match=r"two columns are called 'mx'"):
        read(tmp_path, table(rows(), header=HEADER.replace("my", "mx")))


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\n\n\n",
        HEADER.encode(),
        HEADER.encode() + b"\n",
        b"\0" * 5000,
        b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0",
    ],
    ids=["nothing", "blank lines", "header alone", "header line alone", "zeros", "a picture"],
)
def test_what_is_no_table_is_refused_in_one_line(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(RawError) as caught:
        read(tmp_path, content)
    assert "\n" not in str(caught.value)
    assert "imd1.csv" in str(caught.value)


def test_a_header_of_a_million_columns_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RawError):
        read(tmp_path, ",".join(["x"] * 1_000_000) + "\n" + "1\n" * 10)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=300), st.integers(0, 4000))
def test_rubbish_in_a_table_never_raises_anything_but_a_named_refusal(
    tmp_path: Path, rubbish: bytes, at: int
) -> None:
    text = table(rows()[:40]).encode()
    try:
        raw = read(tmp_path, text[:at] + rubbish + text[at:])
    except RawError:
        return
    assert np.isfinite(raw.specific_force).all()
    assert np.isfinite(raw.angular_velocity).all()


EUROC = (
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
)
KALIBR = "timestamp,omega_x,omega_y,omega_z,alpha_x,alpha_y,alpha_z"


@pytest.mark.parametrize("header", [EUROC, KALIBR])
def test_well_known_loggers_need_no_columns(tmp_path: Path, header: str) -> None:
    cells = [[row[0], *row[6:9], *row[3:6]] for row in rows()]
    raw = read(tmp_path, table(cells, header=header))
    assert raw.specific_force == pytest.approx(numbers()[:, :3])
    assert raw.angular_velocity == pytest.approx(numbers()[:, 3:6])
    assert raw.counter is None
    assert raw.host_ns[0] == START


def test_an_xsens_dot_export_is_timed_by_its_counter_and_turned_to_radians(tmp_path: Path) -> None:
    preamble = "sep=,\nDeviceTag:,D1\nFirmwareVersion:,1.6.0\n\n"
    header = "PacketCounter,SampleTimeFine,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z,"
    first = 2**32 - 500_000
    cells = [[str(k), str((first + k * 10_000) % 2**32), *row[3:9], ""] for k, row in enumerate(rows())]
    raw = read(tmp_path, preamble + table(cells, header=header))
    assert np.diff(raw.host_ns).tolist() == [10_000_000] * (N - 1)  # across the wrap
    assert raw.angular_velocity == pytest.approx(np.radians(numbers()[:, 3:6]))
    assert any("counter is the clock" in w.effect for w in raw.warnings)


def test_steering_in_degrees_of_another_logger_is_read(tmp_path: Path) -> None:
    path = tmp_path / "steer.csv"
    lines = [f"{1747216800.0 + k / 50:.3f};{(k % 7) / 2:.1f}".replace(".", ",") for k in range(100)]
    path.write_text("Zeit;Lenkwinkel\n" + "\n".join(lines) + "\n")
    sensor = Steer(
        kind="steer",
        file="steer.csv",
        rate=50.0,
        columns={"t_host_ns": "Zeit", "angle": "Lenkwinkel"},
        units=Units(host_time="s", angle="deg"),
    )
    raw = steer_csv.read(path, sensor, "steer", DATE)
    assert raw.angle == pytest.approx(np.radians([(k % 7) / 2 for k in range(100)]))
    assert raw.host_ns[1] - raw.host_ns[0] == 20_000_000


def test_a_steering_angle_beyond_a_right_angle_is_dropped(tmp_path: Path) -> None:
    path = tmp_path / "steer.csv"
    lines = [f"{START + k * 20_000_000},{0.1 if k != 7 else 12.0}" for k in range(100)]
    path.write_text("t_host_ns,angle\n" + "\n".join(lines) + "\n")
    raw = steer_csv.read(path, Steer(kind="steer", file="steer.csv", rate=50.0), "steer", DATE)
    assert raw.angle.size == 99
    assert raw.warnings[0].row == 9
