"""Which column of an unknown header is which: by the words that loggers use."""

from __future__ import annotations

import re
from collections.abc import Sequence

AXIS_WORDS = {
    "a": r"a|acc|accel|acceleration|accelerometer|linear_?acceleration",
    "g": r"g|gyr|gyro|gyroscope|w|omega|rate|angular_?(?:velocity|rate)|rot",
    "m": r"m|mag|magn|magnetometer|magnetic_?field",
}
HOST_WORDS = ("t_host_ns", "host_time", "t_host", "timestamp", "time", "unix", "epoch", "utc", "t")
DEVICE_WORDS = ("t_dev_us", "t_dev", "device_time", "ticks", "micros", "timer", "sampletimefine")
SEQ_WORDS = ("seq", "sequence", "packetcounter", "counter", "sample", "count")
ANGLE_WORDS = ("angle", "steer", "steering", "steering_angle", "wheel_angle", "steer_angle", "lenkwinkel")
SPEED_WORDS = (
    *("speed", "wheel_speed", "wheelspeed", "vehicle_speed", "ground_speed", "machine_speed"),
    *("wheel_based_machine_speed", "wheel_based_vehicle_speed", "velocity", "geschwindigkeit"),
)
WHEEL_MARK = r"{0}_?{1}|{1}_?{0}|(?:^|_|speed|wheel|spd)(?:{2}{3}|{3}{2})(?:$|_|speed|wheel|spd)"
WHEEL_MARKS = {  # how a wheel is told in the name of a column
    f"{end}_{side}": WHEEL_MARK.format(end, side, end[0], side[0])
    for end in ("front", "rear")
    for side in ("right", "left")
}
WHEEL_SPEED = re.compile(r"wheel|speed|spd|velocity")
SPEED_MARKS = (
    ("km/h", r"km/?h|kph"),
    ("mph", r"mph|mi/h"),
    ("mm/s", r"mm/s"),
    ("rad/s", r"rad/?s"),
    ("rpm", r"rpm|1/min|u/min"),
    ("m/s", r"m/s|mps|^ms$"),
)
UNIT_MARKS = (
    ("accel", "g", r"\bg\b"),
    ("gyro", "deg/s", r"deg|dps|°"),
    ("mag", "uT", r"ut|µt|μt"),
    ("mag", "gauss", r"gauss"),
)


def _bare(name: str) -> str:
    """Lower case, without units in brackets."""
    return re.sub(r"[\[(].*?[\])]", "", name).strip().lower().replace(" ", "_").replace("-", "_").strip("_#")


def guess_inertial(names: Sequence[str]) -> tuple[dict[str, str] | None, dict[str, str], list[str]]:
    """Columns by standard name (None: this is no inertial table), units stated in the header, reasons."""
    bare = {name: _bare(name) for name in names if name}
    columns: dict[str, str] = {}
    for letter, words in AXIS_WORDS.items():
        for axis in "xyz":
            pattern = re.compile(rf"(?:{words})_?\.?{axis}(?:_.*)?|{axis}_?(?:{words})")
            match = next((name for name, plain in bare.items() if pattern.fullmatch(plain)), None)
            if match is not None and match not in columns.values():
                columns[letter + axis] = match
    if not {"ax", "ay", "az", "gx", "gy", "gz"} <= set(columns):
        return None, {}, []
    for key, known in (("t_host_ns", HOST_WORDS), ("t_dev_us", DEVICE_WORDS), ("seq", SEQ_WORDS)):
        found = _by_words(bare, known)
        if found is not None and found not in columns.values():
            columns[key] = found
    shown = ", ".join(f"{key} = {name}" for key, name in columns.items() if key != name)
    return columns, _units(columns), [f"columns by their names: {shown}"] if shown else ["standard columns"]


def _by_words(bare: dict[str, str], words: Sequence[str]) -> str | None:
    for word in words:
        for name, plain in bare.items():
            if plain == word or (len(word) > 1 and plain.startswith(word + "_")):
                return name
    return None


def _units(columns: dict[str, str]) -> dict[str, str]:
    """Units written in the headers' brackets."""
    units = {}
    for key, letter in (("accel", "a"), ("gyro", "g"), ("mag", "m")):
        inside = " ".join(re.findall(r"[\[(](.*?)[\])]", columns.get(letter + "x", ""))).lower()
        for unit_key, unit, pattern in UNIT_MARKS:
            if unit_key == key and re.search(pattern, inside):
                units[key] = unit
    return units


def guess_speeds(names: Sequence[str]) -> tuple[str | None, list[tuple[str, str | None]]]:
    """A bus's column of time (None: there is none), and its columns of speed, each with the wheel that it tells."""
    bare = {name: _bare(name) for name in names if name}
    time = _by_words(bare, HOST_WORDS)
    bare = {name: _bare(re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name)) for name in bare}
    wheels: dict[str, str] = {}
    for wheel, pattern in WHEEL_MARKS.items():
        for name, plain in bare.items():
            if WHEEL_SPEED.search(plain) and re.search(pattern, plain) and wheel not in wheels.values():
                wheels[name] = wheel
    found: list[tuple[str, str | None]] = list(wheels.items())
    whole = _by_words({name: plain for name, plain in bare.items() if name not in wheels}, SPEED_WORDS)
    if not found and whole is not None and whole != time:
        found = [(whole, None)]
    return time, found


def speed_unit(name: str) -> str | None:
    """The unit of speed that a column's name states, in brackets or at its end; None where it states none."""
    inside = " ".join(re.findall(r"[\[(](.*?)[\])]", name)) or name.rsplit("_", 1)[-1]
    return next((unit for unit, mark in SPEED_MARKS if re.search(mark, inside.lower())), None)


def guess_steering(names: Sequence[str]) -> tuple[dict[str, str] | None, list[str]]:
    """Columns of a steering table (None: it is none) and reasons."""
    bare = {name: _bare(name) for name in names if name}
    time, angle = _by_words(bare, HOST_WORDS), _by_words(bare, ANGLE_WORDS)
    if time is None or angle is None or time == angle:
        return None, []
    return {"t_host_ns": time, "angle": angle}, [f"a time and an angle: columns {time}, {angle}"]
