"""The twin's records and files: clocks, faults, NMEA, determinism, and the contract with the reader of
raw passes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pynmeagps import NMEAReader
from scipy.stats import chi2
from smts_validate.pipeline import twin, twin_inertial
from smts_validate.pipeline.twin import Twin, make_pass, write_raw
from smts_validate.pipeline.twin_plan import PRESETS, changed, preset
from smts_validate.sensors.geodesy import to_enu
from smts_validate.sensors.ingest import read_pass
from smts_validate.sensors.streams import GnssStream, ImuStream

SHORT = changed(preset("benign"), {"path": {"duration": 30.0}})


@pytest.fixture(scope="module")
def made() -> Twin:
    return make_pass(SHORT, 5)


def _parsed(lines: list[str]) -> list[tuple[float, Any]]:
    """(host time in s, message) by another's parser, its checksum test on."""
    return [
        (int(line.split(" ")[0]) / 1e9, NMEAReader.parse(line.split(" ", 1)[1], validate=1)) for line in lines
    ]


def _seconds(clock: Any) -> float:
    return clock.hour * 3600 + clock.minute * 60 + clock.second + clock.microsecond / 1e6


def test_noise_at_rest_is_that_of_the_data_sheet() -> None:
    still = changed(SHORT, {"path": {"rest": 30.0}, "errors": {"vibration": 0.0}})
    made = make_pass(still, 2)
    low, high = (chi2.ppf(p, 2900) / 2900 for p in (0.0005, 0.9995))
    for name, unit in made.units.items():
        spread = unit.values[: unit.t.size].std(axis=0)
        gyro = twin_inertial.GYRO_NOISE * 10.0  # sigma = density·√rate
        step = twin_inertial.GYRO_RANGE[still.sensors[name]["kind"]] / 32768
        expected = np.hypot(gyro, step / np.sqrt(12.0))  # noise and the converter's rounding
        assert (low < (spread[3:6] / expected) ** 2).all(), name
        assert ((spread[3:6] / expected) ** 2 < high).all(), name


def test_a_better_unit_is_quieter_and_a_perfect_one_reports_the_truth() -> None:
    errors = {"misalignment_deg": 0.0, "bias_scale": 0.0, "noise_scale": 0.0, "vibration": 0.0}
    made = make_pass(changed(SHORT, {"errors": errors}), 2)
    unit, body = made.units["imd1"], made.world.bodies["tractor"]
    ideal = body.feel(unit.t).at(SHORT.sensors["imd1"]["position"])
    assert np.abs(unit.values[:, :3] - ideal.force).max() < 3e-3  # half a step and the slow wander
    assert np.abs(unit.values[:, 3:6] - ideal.rate).max() < 3e-4


def test_counters_wrap_and_stay_in_their_range() -> None:
    made = make_pass(changed(SHORT, {"clocks": {"wrap": True}, "faults": {"lost": 0.0, "doubled": 0.0}}), 1)
    for unit in made.units.values():
        assert (unit.t_dev_us.min(), unit.seq.min()) >= (0, 0)
        assert unit.t_dev_us.max() < 2**32
        assert unit.seq.max() < 2**16
        assert (np.diff(unit.t_dev_us) < 0).sum() == 1
        assert (np.diff(unit.seq) < 0).sum() == 1


def test_the_units_own_clock_drifts_by_its_rate_and_the_logger_is_never_early(made: Twin) -> None:
    host = made.world.host
    for unit in made.units.values():
        device = np.unwrap(unit.t_dev_us / 2**32 * 2 * np.pi) / (2 * np.pi) * 2**32 / 1e6
        slope, _ = np.polyfit(unit.t, device, 1)
        assert abs(slope - 1.0) < 200e-6
        late = (unit.t_host_ns - host.start_ns) / 1e9 - host.offset - unit.t
        assert late.min() >= 0.001 - 1e-6
        assert np.median(late) < 0.02


def test_lost_and_doubled_rows_come_in_their_planned_shares() -> None:
    faults = {"lost": 0.02, "doubled": 0.01, "disordered": 0.01}
    made = make_pass(changed(SHORT, {"faults": faults}), 4)
    steps = np.concatenate([np.diff(unit.seq) % 65536 for unit in made.units.values()]).astype(int)
    rows = steps.size
    assert (steps == 0).sum() / rows == pytest.approx(0.01, abs=0.004)
    assert (steps > 32768).sum() / rows == pytest.approx(0.01, abs=0.005)  # a step back
    span = sum(int(unit.seq.size) for unit in made.units.values())
    unique = sum(np.unique(unit.seq).size for unit in made.units.values())
    whole = sum(int(np.ptp(np.unwrap(unit.seq, period=65536))) + 1 for unit in made.units.values())
    assert 1.0 - unique / whole == pytest.approx(0.02, abs=0.006)
    assert span > unique


def test_a_fault_more_leaves_all_else_as_it_was(made: Twin) -> None:
    gap = make_pass(changed(SHORT, {"faults": {"gaps": [["imd2", 10.0, 2.0]]}}), 5)
    first, second = made.units["imd2"], gap.units["imd2"]
    kept = (first.t < 10.0) | (first.t >= 12.0)
    assert (first.values[kept] == second.values).all()
    assert gap.nmea == made.nmea
    assert (gap.truth == made.truth).all()


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(made: Twin, tmp_path: Path) -> None:
    again, other = make_pass(SHORT, 5), make_pass(SHORT, 6)
    for name, one in (("a", made), ("b", again), ("c", other)):
        write_raw(one, tmp_path / name / "raw")
    for path in sorted((tmp_path / "a").rglob("*.*")):
        same = (tmp_path / "b" / path.relative_to(tmp_path / "a")).read_bytes()
        assert path.read_bytes() == same, path.name
    assert (tmp_path / "a/raw/imd1.csv").read_bytes() != (tmp_path / "c/raw/imd1.csv").read_bytes()


def test_others_can_parse_every_sentence_and_find_the_antenna_where_it_is(made: Twin) -> None:
    messages = _parsed(made.nmea["gps"])
    assert {m.msgID for _, m in messages} == {"GGA", "RMC", "VTG", "GST", "GSA"}
    fixes = [m for _, m in messages if m.msgID == "GGA"]
    seconds = np.array([_seconds(m.time) for m in fixes]) - SHORT.run.start
    lat, lon, alt = (np.array([float(getattr(m, k)) for m in fixes]) for k in ("lat", "lon", "alt"))
    east, north, up = to_enu(lat, lon, alt + 16.0, SHORT.place)
    true = made.world.bodies["tractor"].point(seconds, SHORT.sensors["gps"]["position"])
    error = np.column_stack([east, north, up]) - true
    assert np.sqrt(np.mean(error[:, :2] ** 2)) < 0.03
    assert np.diff(error[:, 0]).std() == pytest.approx(np.sqrt(2.0) * 0.006, rel=0.15)  # the white part
    speeds = np.array([float(m.spd) for _, m in messages if m.msgID == "RMC"]) * 1852.0 / 3600.0
    velocity = made.world.bodies["tractor"].point_velocity(seconds, SHORT.sensors["gps"]["position"])
    moving = seconds > 12.0
    off = (speeds - np.hypot(velocity[:, 0], velocity[:, 1]))[moving]
    assert off.std() == pytest.approx(0.02, rel=0.25)
    assert abs(off.mean()) < 0.01


def test_sentences_arrive_20_to_300_ms_late_and_in_order(made: Twin) -> None:
    host = made.world.host
    stamps = np.array([int(line.split(" ")[0]) for line in made.nmea["gps"]])
    assert (np.diff(stamps) > 0).all()
    for stamp, message in _parsed(made.nmea["gps"]):
        if message.msgID == "GGA":
            late = stamp - host.offset - host.start_ns / 1e9 - (_seconds(message.time) - SHORT.run.start)
            assert 0.019 < late < 0.3


def test_outages_floats_singles_and_spikes_happen_when_they_are_planned() -> None:
    gnss = {"outages": [[10.0, 3.0]], "floats": [[13.0, 4.0]], "singles": [[20.0, 2.0]]}
    jump = {"spikes": [[25.0, 1.0, 0.4]]}
    spiked, plain = (make_pass(changed(SHORT, {"gnss": g}), 5) for g in ({**gnss, **jump}, gnss))
    fixes = [m for _, m in _parsed(spiked.nmea["gps"]) if m.msgID == "GGA"]
    for message in fixes:
        t = _seconds(message.time) - SHORT.run.start
        expected = 0 if 10.0 <= t < 12.99 else 5 if 13.0 <= t < 16.99 else 1 if 20.0 <= t < 21.99 else 4
        assert int(message.quality) == expected
    calm = [m for _, m in _parsed(plain.nmea["gps"]) if m.msgID == "GGA"]
    for message, usual in zip(fixes, calm, strict=True):
        if int(message.quality) == 4:
            args = [(float(m.lat), float(m.lon), 0.0) for m in (message, usual)]
            (ax, ay, _), (bx, by, _) = (to_enu(*a, SHORT.place) for a in args)
            t = _seconds(message.time) - SHORT.run.start
            assert float(np.hypot(ax - bx, ay - by)) == pytest.approx(
                0.4 if 25.0 <= t < 25.99 else 0.0, abs=1e-4
            )


def test_stated_gst_is_the_spread_of_the_errors_over_many_passes() -> None:
    errors, stated = [], []
    for seed in range(40):
        made = make_pass(changed(SHORT, {"path": {"duration": 6.0, "rest": 6.0}}), seed)
        messages = [m for _, m in _parsed(made.nmea["gps"])]
        lat, lon = (
            np.array([float(getattr(m, k)) for m in messages if m.msgID == "GGA"]) for k in ("lat", "lon")
        )
        east, north, _ = to_enu(lat, lon, np.full(lat.size, SHORT.place.alt), SHORT.place)
        true = made.world.bodies["tractor"].point(np.array([3.0]), SHORT.sensors["gps"]["position"])[0]
        errors.append([np.mean(east) - true[0], np.mean(north) - true[1]])
        stated += [float(m.stdLat) for m in messages if m.msgID == "GST"]
    slow = float(np.sqrt(np.mean(np.square(errors))))
    assert np.median(stated) == pytest.approx(np.hypot(0.006, 0.009), rel=0.1)
    assert slow == pytest.approx(0.009, rel=0.3)  # what averages over 6 s leave


def test_a_bad_checksum_is_only_where_it_is_planned() -> None:
    made = make_pass(changed(SHORT, {"faults": {"bad_checksums": 0.05}}), 5)
    bad = 0
    for line in made.nmea["gps"]:
        text, stated = line.split(" ", 1)[1][1:].split("*")
        total = 0
        for byte in text.encode():
            total ^= byte
        bad += f"{total:02X}" != stated
    assert bad / len(made.nmea["gps"]) == pytest.approx(0.05, abs=0.02)


def test_the_southern_hemisphere_is_south_and_west_is_west() -> None:
    made = make_pass(changed(SHORT, {"place": {"lat": -33.5, "lon": -60.2}}), 1)
    fix = next(m for _, m in _parsed(made.nmea["gps"]) if m.msgID == "GGA")
    assert (fix.NS, fix.EW) == ("S", "W")
    assert float(fix.lat) == pytest.approx(-33.5, abs=1e-3)


def test_reading_a_pass_gives_back_what_the_units_measured_when_they_measured_it(
    made: Twin, tmp_path: Path
) -> None:
    write_raw(made, tmp_path / "raw")
    log = read_pass(tmp_path / "raw")
    start = made.world.host.start_ns / 1e9
    for name, unit in made.units.items():
        stream = log.streams[name]
        assert isinstance(stream, ImuStream)
        first = np.unique(unit.t, return_index=True)[1]
        assert stream.specific_force == pytest.approx(unit.values[first, :3], abs=1e-4)
        assert stream.angular_velocity == pytest.approx(unit.values[first, 3:6], abs=1e-6)
        assert stream.t - start == pytest.approx(unit.t[first], abs=0.1)  # GNSS latency is not yet known
        assert np.diff(stream.t - start - unit.t[first]).std() < 1e-4
    gnss = log.streams["gps"]
    assert isinstance(gnss, GnssStream)
    assert gnss.t[0] - start == pytest.approx(0.1, abs=1e-6)


def test_other_loggers_units_and_names_are_written_and_read_alike(tmp_path: Path) -> None:
    units = {"accel": "g", "gyro": "deg/s", "mag": "uT", "host_time": "ms", "device_time": "s"}
    foreign = {"sensors": {"imd1": {"units": units, "columns": {"ax": "AccX", "t_host_ns": "time"}}}}
    streams = []
    for name, plan in (("plain", SHORT), ("foreign", changed(SHORT, foreign))):
        write_raw(make_pass(plan, 5), tmp_path / name / "raw")
        streams.append(read_pass(tmp_path / name / "raw").streams["imd1"])
    plain, other = streams
    assert isinstance(plain, ImuStream)
    assert isinstance(other, ImuStream)
    assert (tmp_path / "foreign/raw/imd1.csv").read_text().startswith("time,t_dev_us,seq,AccX,ay")
    assert other.specific_force == pytest.approx(plain.specific_force, abs=1e-3)
    assert other.angular_velocity == pytest.approx(plain.angular_velocity, abs=1e-6)
    assert other.t == pytest.approx(plain.t, abs=1e-5)


def test_steer_csv_is_the_true_angle_with_its_zero_and_scale() -> None:
    plan = changed(SHORT, {"sensors": {"steer": {"kind": "steer", "file": "steer.csv", "rate": 50.0}}})
    made = make_pass(plan, 5)
    record = made.steering["steer"]
    true = np.interp(record.t, made.world.motion.t, made.world.motion.steer)
    late = record.t > 10.0
    scale, zero = np.polyfit(true[late], record.angle[late], 1)
    assert abs(np.degrees(zero)) < 1.0
    assert scale == pytest.approx(1.0, abs=0.04)
    assert np.degrees((record.angle - scale * true - zero)[late].std()) == pytest.approx(0.08, rel=0.1)


def test_a_dual_antenna_states_the_bodys_heading() -> None:
    gps2 = {"kind": "gps", "body": "seeder", "file": "gps2.nmea", "position": [-0.5, 0.0, 1.6], "rate": 10.0}
    plan = changed(SHORT, {"sensors": {"gps2": gps2}, "gnss": {"heading": ["gps2"]}})
    made = make_pass(plan, 5)
    assert not any("HDT" in line for line in made.nmea["gps"])
    headings = [m for _, m in _parsed(made.nmea["gps2"]) if m.msgID == "HDT"]
    t = 0.1 * np.arange(1, len(headings) + 1)
    yaw = np.degrees(made.world.bodies["seeder"].place(t)[:, 5])
    off = (90.0 - np.array([float(m.headingT) for m in headings]) - yaw + 180.0) % 360.0 - 180.0
    assert off.std() == pytest.approx(0.15, rel=0.2)
    assert abs(off.mean()) < 0.5


def test_a_tractor_alone_has_no_second_body(tmp_path: Path) -> None:
    alone = {
        "machine": {"seeder": False, "tyres": {"seeder": False}},
        "sensors": {"imd2": False, "imd3": False},
    }
    made = make_pass(changed(SHORT, alone), 1)
    assert np.isnan(made.truth[:, 5:8]).all()
    write_raw(made, tmp_path / "raw")
    log = read_pass(tmp_path / "raw")
    assert log.manifest.machine.seeder is None
    assert "imd2" not in log.streams


def test_a_log_without_counters_times_or_magnetometers_can_be_planned(tmp_path: Path) -> None:
    plan = changed(
        SHORT, {"clocks": {"no_device_time": True, "no_seq": True}, "errors": {"magnetometers": False}}
    )
    write_raw(make_pass(plan, 1), tmp_path / "raw")
    header = (tmp_path / "raw/imd1.csv").read_text().split("\n", 1)[0]
    assert header == "t_host_ns,ax,ay,az,gx,gy,gz"
    assert isinstance(read_pass(tmp_path / "raw").streams["imd1"], ImuStream)


def test_truth_is_written_beside_the_pass_in_the_columns_of_the_format(made: Twin, tmp_path: Path) -> None:
    write_raw(made, tmp_path / "raw")
    lines = (tmp_path / "truth.csv").read_text().splitlines()
    assert lines[0] == "t,x1,y1,yaw1,v1,x2,y2,yaw2,steer"
    rows = np.genfromtxt(lines[1:], delimiter=",")
    times = made.world.host.start_ns / 1e9 + 0.02 * np.arange(rows.shape[0])
    assert np.abs(rows[:, 0] - times).max() < 2e-3
    vx, vy, yaw = np.gradient(rows[:, 1], 0.02), np.gradient(rows[:, 2], 0.02), rows[:, 3]
    assert np.abs(vx * np.cos(yaw) + vy * np.sin(yaw) - rows[:, 4])[5:-5].max() < 0.02
    origin = json.loads((tmp_path / "truth_origin.json").read_text())
    assert (origin["lat"], origin["lon"], origin["alt"]) == (
        SHORT.place.lat,
        SHORT.place.lon,
        SHORT.place.alt,
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(PRESETS))
def test_every_preset_makes_a_pass_that_can_be_read(name: str, tmp_path: Path) -> None:
    write_raw(make_pass(preset(name), 1), tmp_path / "raw")
    log = read_pass(tmp_path / "raw")
    assert set(log.streams) == set(preset(name).sensors)


def test_the_worst_of_faults_still_leaves_a_pass_that_can_be_read(tmp_path: Path) -> None:
    faults = {
        "lost": 0.05, "doubled": 0.02, "disordered": 0.02, "empty": 0.002, "bad_checksums": 0.02,
        "cut_last_row": True, "gaps": [["wds1", 8.0, 4.0]],
    }  # fmt: skip
    plan = changed(SHORT, {"faults": faults, "clocks": {"wrap": True, "host_drift_ppm": 20.0}})
    write_raw(make_pass(plan, 1), tmp_path / "raw")
    log = read_pass(tmp_path / "raw")
    assert len(log.warnings) > 0
    assert log.streams["wds1"].t.size > 1500


def test_wheel_radii_misalignment_and_biases_are_drawn_at_their_planned_size() -> None:
    streams = (twin.stream(seed, "imd1 errors") for seed in range(400))
    errors = [twin_inertial.draw_errors(SHORT.errors, 100.0, rng) for rng in streams]
    doubled = replace(SHORT.errors, bias_scale=2.0)
    for name, sigma in (("gyro_bias", twin_inertial.GYRO_BIAS), ("misalignment_deg", 0.2)):
        assert np.std([getattr(e, name) for e in errors]) == pytest.approx(sigma, rel=0.08)
    first = twin_inertial.draw_errors(doubled, 100.0, twin.stream(0, "imd1 errors"))
    assert first.gyro_bias == pytest.approx(2.0 * errors[0].gyro_bias)


def test_a_unit_that_restarts_is_silent_and_counts_from_zero() -> None:
    made = make_pass(
        changed(SHORT, {"faults": {"restarts": [["imd1", 15.0]], "lost": 0.0, "doubled": 0.0}}), 5
    )
    unit = made.units["imd1"]
    after = unit.t >= 16.5
    assert not ((unit.t >= 15.0) & ~after).any()
    assert (unit.t_dev_us[after][0], unit.seq[after][0]) == (0, 0)
    assert (np.diff(unit.seq[after]) == 1).all()
    assert (np.diff(made.units["imd2"].t) < 0.02).all()
