"""A raw pass's folder, read whole: times against truth, faults by name, nothing from outside the folder."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from raw_samples import START, Plan, checked, gps_lines, imu_lines, write_pass, yaw_rate
from smts_validate.sensors.ingest import IngestError, read_pass
from smts_validate.sensors.manifest import ManifestError
from smts_validate.sensors.streams import FieldLog, GnssStream, ImuStream, SteerStream, WheelStream

VISIBLE = Path(__file__).resolve().parents[3] / "shared" / "examples" / "visible" / "raw" / "visible-1"


def imu(log: FieldLog, name: str = "imd1") -> ImuStream:
    stream = log.streams[name]
    assert isinstance(stream, ImuStream)
    return stream


def rate_error(log: FieldLog, shift: float) -> float:
    """RMS difference of the measured yaw rate from the truth at the reconstructed instants + `shift`."""
    stream = imu(log)
    return float(np.sqrt(np.mean((stream.angular_velocity[:, 2] - yaw_rate(stream.t - START + shift)) ** 2)))


def test_a_pass_is_read_onto_utc(tmp_path: Path) -> None:
    log = read_pass(write_pass(tmp_path / "pass", Plan(gnss_latency=0.1)))
    stream = imu(log)
    assert stream.t.size == 6000
    truth = START + np.arange(6000) / (100.0 * (1.0 + 40e-6))
    assert (
        np.abs(stream.t - truth).max() < 6e-3
    )  # what the receiver's jitter leaves, its least latency being assumed
    assert np.diff(stream.t) == pytest.approx(0.01 / (1.0 + 40e-6), abs=5e-6)
    assert rate_error(log, 0.0) < 0.003
    gnss = log.streams["gps"]
    assert isinstance(gnss, GnssStream)
    assert gnss.t == pytest.approx(START + np.arange(0.0, 60.0, 0.1), abs=1e-4)
    assert gnss.alt == pytest.approx(150.0)
    assert (gnss.t_arrival >= gnss.t + 0.099).all()
    assert (stream.t_arrival > stream.t).all()


def test_all_streams_but_gnss_share_one_shift(tmp_path: Path) -> None:
    early = read_pass(write_pass(tmp_path / "early", Plan(gnss_latency=0.05)))
    late = read_pass(write_pass(tmp_path / "late", Plan(gnss_latency=0.15)))
    shift = imu(early).t - imu(late).t
    assert shift == pytest.approx(0.1, abs=1e-6)
    assert np.array_equal(early.streams["gps"].t, late.streams["gps"].t)


def test_without_host_times_the_offset_comes_from_the_motion(tmp_path: Path) -> None:
    log = read_pass(write_pass(tmp_path / "pass", Plan(offset=-7.125), prefix=False))
    assert log.health["clock"]["host_minus_utc_s"] == pytest.approx(-7.125, abs=0.01)
    assert log.health["clock"]["host_minus_utc_sd_s"] < 0.02
    assert rate_error(log, 0.0) < 0.004
    assert any("from the motion" in warning.effect for warning in log.warnings)


def test_without_host_times_and_without_turning_the_pass_is_refused(tmp_path: Path) -> None:
    folder = write_pass(tmp_path / "pass", prefix=False)
    rows = [row.rsplit(",", 1)[0] + ",0.000100" for row in imu_lines(Plan())]
    header = "t_host_ns,t_dev_us,seq,ax,ay,az,gx,gy,gz"
    (folder / "imd1.csv").write_text("\n".join([header, *rows]) + "\n")
    with pytest.raises(IngestError, match="motion does not tell the offset") as caught:
        read_pass(folder)
    assert "\n" not in str(caught.value)


def test_a_jump_of_the_loggers_clock_is_taken_out_of_every_stream(tmp_path: Path) -> None:
    plan = Plan(gnss_latency=0.1)
    folder = write_pass(tmp_path / "pass", plan)
    after = (START + plan.offset + 30.0) * 1e9

    def jumped(line: str, separator: str) -> str:
        stamp, rest = line.split(separator, 1)
        return f"{int(stamp) + (5_000_000_000 if int(stamp) > after else 0)}{separator}{rest}"

    rows = [jumped(row, ",") for row in imu_lines(plan)]
    (folder / "imd1.csv").write_text("\n".join(["t_host_ns,t_dev_us,seq,ax,ay,az,gx,gy,gz", *rows]) + "\n")
    (folder / "gps.nmea").write_text("\n".join(jumped(row, " ") for row in gps_lines(plan)) + "\n")
    log = read_pass(folder)
    assert rate_error(log, 0.0) < 0.004
    jumps = [warning for warning in log.warnings if "clock jumped by 5.0" in warning.what]
    assert {warning.sensor for warning in jumps} == {"imd1", "gps"}
    assert all(warning.row is not None for warning in jumps)


def test_kinds_of_sensor_become_kinds_of_stream(tmp_path: Path) -> None:
    rest = """[sensors.wds1]
kind = "wds"
wheel = "front_left"
file = "wds1.csv"
rate = 100.0
[sensors.steer]
kind = "steer"
file = "steer.csv"
rate = 50.0
"""
    plan = Plan(rest=rest)
    wheel = "\n".join(["t_host_ns,t_dev_us,seq,ax,ay,az,gx,gy,gz", *imu_lines(plan)]) + "\n"
    stamps = [round((START + plan.offset + k / 50.0) * 1e9) for k in range(3000)]
    steer = "t_host_ns,angle\n" + "".join(f"{stamp},{0.1:.4f}\n" for stamp in stamps)
    log = read_pass(
        write_pass(tmp_path / "pass", Plan(rest=rest, extra={"wds1.csv": wheel, "steer.csv": steer}))
    )
    assert [type(stream) for stream in log.streams.values()] == [
        ImuStream,
        GnssStream,
        WheelStream,
        SteerStream,
    ]
    assert log.of_type(SteerStream)["steer"].t.size == 3000


@pytest.mark.parametrize("name", ["../secret.csv", "/etc/passwd", "a/../../b.csv", "C:\\x.csv", ""])
def test_a_file_outside_the_folder_is_refused_by_the_manifest(tmp_path: Path, name: str) -> None:
    folder = write_pass(tmp_path / "pass")
    text = (folder / "run.toml").read_text().replace('"imd1.csv"', repr(name))
    (folder / "run.toml").write_text(text)
    with pytest.raises(ManifestError, match="inside the pass's folder"):
        read_pass(folder)


def test_a_link_out_of_the_folder_is_refused(tmp_path: Path) -> None:
    folder = write_pass(tmp_path / "pass")
    shutil.move(folder / "imd1.csv", tmp_path / "secret.csv")
    (folder / "imd1.csv").symlink_to(tmp_path / "secret.csv")
    with pytest.raises(IngestError, match="leads out of the pass's folder"):
        read_pass(folder)


def test_a_link_within_the_folder_is_followed(tmp_path: Path) -> None:
    folder = write_pass(tmp_path / "pass")
    shutil.move(folder / "imd1.csv", folder / "recorded.csv")
    (folder / "imd1.csv").symlink_to("recorded.csv")
    assert imu(read_pass(folder)).t.size == 6000


def test_a_pipe_is_no_log_and_does_not_block(tmp_path: Path) -> None:
    folder = write_pass(tmp_path / "pass")
    (folder / "imd1.csv").unlink()
    os.mkfifo(folder / "imd1.csv")
    with pytest.raises(IngestError, match="not a regular file"):
        read_pass(folder)


def test_a_huge_sparse_file_is_refused_at_once(tmp_path: Path) -> None:
    folder = write_pass(tmp_path / "pass")
    with (folder / "imd1.csv").open("r+b") as file:
        file.truncate(10 * 2**30)
    with pytest.raises(IngestError, match=r"imd1\.csv: is 10\.0 GiB"):
        read_pass(folder)


def test_zeros_that_a_power_cut_left_are_cut_off(tmp_path: Path) -> None:
    folder = write_pass(tmp_path / "pass")
    with (folder / "imd1.csv").open("ab") as file:
        file.write(b"\0" * 4096)
    assert imu(read_pass(folder)).t.size == 6000


def test_a_missing_file_is_named_with_its_sensor(tmp_path: Path) -> None:
    folder = write_pass(tmp_path / "pass")
    (folder / "gps.nmea").unlink()
    with pytest.raises(IngestError, match=r"gps\.nmea: is not there; sensors\.gps"):
        read_pass(folder)


def test_the_same_files_give_the_same_digest_and_others_another(tmp_path: Path) -> None:
    first, second = write_pass(tmp_path / "a"), write_pass(tmp_path / "b")
    assert read_pass(first).sha256 == read_pass(second).sha256
    assert read_pass(write_pass(tmp_path / "c", Plan(seed=3))).sha256 != read_pass(first).sha256


@pytest.mark.skipif(not VISIBLE.exists(), reason="the example is not beside this checkout")
def test_the_example_is_read_whole() -> None:
    log = read_pass(VISIBLE)
    assert list(log.streams) == list(log.manifest.sensors)
    assert all(stream.t.size > 440 for stream in log.streams.values())
    start = [stream.t[0] for stream in log.streams.values()]
    assert np.ptp(start) < 0.5
    assert log.health["imd1"]["lost"] == 4


def test_a_receiver_that_had_no_time_at_first_does_not_mislead_the_clocks(tmp_path: Path) -> None:
    plan = Plan(gnss_latency=0.1)
    folder = write_pass(tmp_path / "pass", plan)
    lines = gps_lines(plan)
    first = int(lines[0].split()[0])
    clocks = [f"2359{40 + k // 10:02d}.{k % 10}0" for k in range(20)]
    stamps = [first - (20 - k) * 100_000_000 for k in range(20)]
    bodies = [checked(f"GNGGA,{clock},,,,,0,00,99.9,,M,,M,,") for clock in clocks]
    cold = [f"{stamp} {body}" for stamp, body in zip(stamps, bodies, strict=True)]
    (folder / "gps.nmea").write_text("\n".join([*cold, *lines]) + "\n")
    log = read_pass(folder)
    assert log.streams["gps"].t[0] == START
    assert log.streams["gps"].t.size == 600
    assert rate_error(log, 0.0) < 0.004
    dropped = [w for w in log.warnings if "not that of their arrival" in w.what]
    assert [(w.row, w.what.split()[0]) for w in dropped] == [(1, "20")]


def test_a_sound_sentence_with_a_wrong_time_is_dropped(tmp_path: Path) -> None:
    plan = Plan(gnss_latency=0.1)
    folder = write_pass(tmp_path / "pass", plan)
    lines = gps_lines(plan)
    for at, clock in ((300, "093000.00"), (600, "113000.00")):
        stamp, text = lines[at].split()
        body = text[1:-3].split(",")
        lines[at] = f"{stamp} {checked(','.join([body[0], clock, *body[2:]]))}"
    (folder / "gps.nmea").write_text("\n".join(lines) + "\n")
    log = read_pass(folder)
    assert rate_error(log, 0.0) < 0.004
    assert any("2 epochs whose time" in w.what and w.row == 301 for w in log.warnings)
    assert log.streams["gps"].t.size == 600  # the epochs' other sentences remain


def test_two_receivers_keep_their_own_times_on_one_host(tmp_path: Path) -> None:
    rest = '[sensors.gps2]\nkind = "gps"\nfile = "gps2.nmea"\nposition = [0.0, 1.0, 2.0]\nrate = 10.0\n'
    second = "\n".join(gps_lines(Plan(gnss_latency=0.2, seed=9))) + "\n"
    log = read_pass(
        write_pass(tmp_path / "pass", Plan(gnss_latency=0.1, rest=rest, extra={"gps2.nmea": second}))
    )
    later = log.streams["gps2"].t_arrival - log.streams["gps"].t_arrival
    assert np.array_equal(log.streams["gps"].t, log.streams["gps2"].t)
    assert later.mean() == pytest.approx(0.1, abs=0.01)


def test_units_without_host_time_are_placed_by_the_motion_alone(tmp_path: Path) -> None:
    folder = write_pass(tmp_path / "pass", Plan(seconds=120.0), prefix=False)
    rows = [row.split(",") for row in imu_lines(Plan(seconds=120.0))]
    lines = [
        ",".join([row[2], row[1], *row[3:6], *(f"{np.degrees(float(x)):.6f}" for x in row[6:])])
        for row in rows
    ]
    header = "PacketCounter,SampleTimeFine,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z"
    (folder / "imd1.csv").write_text("\n".join([header, *lines]) + "\n")
    log = read_pass(folder)
    assert rate_error(log, 0.0) < 0.004
    assert imu(log).t[0] == pytest.approx(START, abs=0.03)
