"""CDR as columns, against two other implementations (mcap-ros2-support, rosbags)."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from log_samples import STORE, imu, joints
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from smts_validate.sensors.cdr import (
    BLOCK,
    Payloads,
    decode,
    encode,
    layout_of,
    make_template,
    serialise,
    stamp_columns,
)
from smts_validate.sensors.ros_messages import definition, is_known
from smts_validate.sensors.ros_types import CdrError, MessageType, message_type

TYPES = [
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/MagneticField",
    "sensor_msgs/msg/NavSatFix",
    "sensor_msgs/msg/JointState",
    "geometry_msgs/msg/TwistStamped",
    "geometry_msgs/msg/QuaternionStamped",
    "geometry_msgs/msg/PoseStamped",
    "nav_msgs/msg/Odometry",
    "nav_msgs/msg/Path",
    "tf2_msgs/msg/TFMessage",
    "std_msgs/msg/Float64",
    "foxglove_msgs/msg/SceneUpdate",
]


def known(name: str) -> MessageType:
    return message_type(name, definition(name))


def packed(messages: list[bytes], gap: int = 0) -> Payloads:
    """Messages one after the other in a buffer, `gap` bytes of something else before each."""
    data = b"".join(b"\xaa" * gap + each for each in messages)
    length = np.array([len(each) for each in messages], np.int64)
    start = np.cumsum(length + gap) - length
    return Payloads(np.frombuffer(data, np.uint8), start, length)


def another_decoder(name: str, payload: bytes) -> Any:
    """mcap-ros2-support's reading of a message."""
    schema = Schema(id=1, name=name, encoding="ros2msg", data=definition(name).encode())
    decoder = DecoderFactory().decoder_for("cdr", schema)
    assert decoder is not None
    return decoder(payload)


def value_at(message: Any, path: str) -> Any:
    """The value at a dotted path of a decoded message."""
    for part in path.split("."):
        message = message[int(part)] if part.isdigit() else getattr(message, part)
    return list(message) if isinstance(message, bytes) else message  # bytes: their form of uint8[]


def random_values(kind: MessageType, name: str, rng: np.random.Generator) -> dict[str, Any]:
    """A random message of a type as a nested mapping; sequences of 0 to 3."""
    found: dict[str, Any] = {}
    for each in kind.types[name]:
        count = None if each.count is None else int(rng.integers(0, 4)) if each.count < 0 else each.count
        values = [random_value(kind, each.base, rng) for _ in range(1 if count is None else count)]
        found[each.name] = values[0] if count is None else values
    return found


def random_value(kind: MessageType, base: str, rng: np.random.Generator) -> Any:
    if base in kind.types:
        return random_values(kind, base, rng)
    if base == "string":
        return "".join(rng.choice(list("abc/_é"), int(rng.integers(0, 12))))
    if base.startswith("float"):
        return float(rng.normal())
    return int(rng.integers(0, 2)) if base == "bool" else int(rng.integers(0, 127))


@pytest.mark.parametrize("name", TYPES)
def test_every_field_is_what_another_decoder_reads(name: str) -> None:
    kind, rng = known(name), np.random.default_rng(len(name))
    for _ in range(25):
        payload = serialise(kind, random_values(kind, kind.name, rng))
        theirs = another_decoder(name, payload)
        (group,) = decode(kind, packed([payload]))
        for path, leaf in group.layout.leaves.items():
            value: Any = group.column(path)[0]
            expected = value_at(theirs, path)
            if leaf.dtype == "S":
                assert value == expected.encode(), path
            else:
                assert np.array_equal(np.atleast_1d(value), np.atleast_1d(np.array(expected))), path


@pytest.mark.parametrize("name", [each for each in TYPES if "foxglove" not in each])
@pytest.mark.parametrize("little_endian", [True, False])
def test_messages_of_another_serialiser_are_read_in_either_byte_order(name: str, little_endian: bool) -> None:
    kind, rng = known(name), np.random.default_rng(1)
    values = random_values(kind, kind.name, rng)
    theirs = STORE.deserialize_cdr(serialise(kind, values), name)
    payload = bytes(STORE.serialize_cdr(theirs, name, little_endian=little_endian))
    (group,) = decode(kind, packed([payload]))
    for path, leaf in group.layout.leaves.items():
        if leaf.dtype != "S":
            expected = np.atleast_1d(value_at(theirs, path))
            assert np.array_equal(np.atleast_1d(group.column(path)[0]), expected), path


@pytest.mark.parametrize("name", [each for each in TYPES if "foxglove" not in each])
def test_another_serialiser_writes_the_same_bytes(name: str) -> None:
    kind, rng = known(name), np.random.default_rng(2)
    for _ in range(10):
        payload = serialise(kind, random_values(kind, kind.name, rng))
        again = bytes(STORE.serialize_cdr(STORE.deserialize_cdr(payload, name), name))
        assert again == payload


def test_columns_are_encoded_as_single_messages_are() -> None:
    kind, rng, n = known("sensor_msgs/msg/Imu"), np.random.default_rng(3), 20
    force, rate, t_ns = rng.normal(size=(n, 3)), rng.normal(size=(n, 3)), 10**18 + np.arange(n) * 10**7
    template = make_template(kind, {"header": {"frame_id": "imd1"}, "orientation": {"w": 1.0}})
    columns = {"linear_acceleration": force, "angular_velocity": rate, **stamp_columns("header.stamp", t_ns)}
    ours = encode(template, columns, n)
    for i in range(n):
        theirs = STORE.serialize_cdr(imu(int(t_ns[i]), force[i], rate[i], "imd1"), "sensor_msgs/msg/Imu")
        assert ours[i].tobytes() == bytes(theirs)


def imus(count: int, frame: str = "imu", start: int = 0) -> list[bytes]:
    """Serialised by rosbags; linear_acceleration.x counts up."""
    name = "sensor_msgs/msg/Imu"
    return [
        bytes(STORE.serialize_cdr(imu(10**18 + i, (float(start + i), 0, 0), (0, 0, 0), frame), name))
        for i in range(count)
    ]


def test_messages_that_share_a_layout_are_one_group() -> None:
    groups = list(decode(known("sensor_msgs/msg/Imu"), packed(imus(100), gap=31)))
    assert len(groups) == 1
    assert groups[0].column("linear_acceleration.x").tolist() == list(range(100))


def test_messages_of_other_lengths_are_groups_of_their_own_and_none_is_lost() -> None:
    mixed = imus(3, "a") + imus(3, "longer", 3) + imus(3, "b", 6)
    found = np.full(9, np.nan)
    for group in decode(known("sensor_msgs/msg/Imu"), packed(mixed)):
        found[group.rows] = group.column("linear_acceleration.x")
    assert found.tolist() == list(range(9))


def test_many_messages_of_many_layouts_are_all_read() -> None:
    n = 3 * BLOCK // 2
    mixed = [each for i in range(0, n, 64) for each in imus(64, "x" * (i % 11), i)]
    found = np.full(len(mixed), np.nan)
    for group in decode(known("sensor_msgs/msg/Imu"), packed(mixed)):
        found[group.rows] = group.column("linear_acceleration.x")
    assert np.array_equal(found, np.arange(len(mixed)))


def test_equal_lengths_do_not_hide_other_prefixes() -> None:
    # two names of 3 and 5 letters against two of 5 and 3: the same length, other offsets
    name = "sensor_msgs/msg/JointState"
    both = [
        bytes(STORE.serialize_cdr(joints(1, names, [1.0, 2.0]), name))
        for names in (["abc", "abcde"], ["abcde", "abc"])
    ]
    assert len(both[0]) == len(both[1])
    groups = list(decode(known(name), packed(both)))
    assert [[group.column(f"name.{i}")[0] for i in (0, 1)] for group in groups] == [
        [b"abc", b"abcde"],
        [b"abcde", b"abc"],
    ]


def test_either_byte_order_in_one_topic_is_read() -> None:
    name = "sensor_msgs/msg/Imu"
    message = imu(10**18, (1.0, 2.0, 3.0), (0, 0, 0))
    both = [bytes(STORE.serialize_cdr(message, name, little_endian=order)) for order in (True, False, True)]
    found = np.zeros((3, 3))
    for group in decode(known(name), packed(both)):
        found[group.rows] = group.column("linear_acceleration")
    assert found.tolist() == [[1.0, 2.0, 3.0]] * 3


@pytest.mark.parametrize(
    ("payload", "what"),
    [
        (b"", "does not begin as CDR"),
        (b"\x00\x07\x00\x00" + bytes(400), "does not begin as CDR"),
        (b"\x00\x01\x00\x00" + bytes(20), "ends inside"),
        (b"\x00\x01\x00\x00" + bytes(8) + b"\xff\xff\xff\xff" + bytes(300), "claims 4294967295"),
        (imus(1)[0] + bytes(4), "left over"),
    ],
)
def test_what_is_not_a_message_of_the_type_is_refused_by_name(payload: bytes, what: str) -> None:
    with pytest.raises(CdrError, match=what) as caught:
        list(decode(known("sensor_msgs/msg/Imu"), packed([*imus(2), payload])))
    assert "message 2" in str(caught.value)
    assert "sensor_msgs/Imu" in str(caught.value)


@given(st.sampled_from(TYPES), st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(name: str, body: bytes) -> None:
    try:
        layout = layout_of(known(name), b"\x00\x01\x00\x00" + body)
    except CdrError:
        return
    assert layout.length == len(body) + 4


@given(st.integers(0, 10**6), st.integers(0, 255))
def test_a_changed_byte_never_reads_outside_the_message(seed: int, byte: int) -> None:
    kind, rng = known("nav_msgs/msg/Odometry"), np.random.default_rng(seed)
    payload = bytearray(serialise(kind, random_values(kind, kind.name, rng)))
    payload[int(rng.integers(len(payload)))] = byte
    try:
        layout = layout_of(kind, bytes(payload))
    except CdrError:
        return
    for leaf in layout.leaves.values():
        size = (
            (leaf.count or 0)
            if leaf.dtype == "S"
            else int(leaf.dtype[1]) * (1 if leaf.count is None else leaf.count)
        )
        assert leaf.offset + size <= len(payload)


def test_definitions_in_every_notation_are_read() -> None:
    text = """
# a comment
int32 LIMIT=5
string NAME = "x # y"
Point[] corners   # resolved in the own package
float64[<=3] bounded
uint8[3] three 1
string<=10 label "a"
builtin_interfaces/Time at
duration lasted
================================================================================
MSG: demo_msgs/msg/Point
float32 x
"""
    kind = message_type("demo_msgs/msg/Demo", text)
    assert [(each.name, each.base, each.count) for each in kind.fields] == [
        ("corners", "demo_msgs/Point", -1),
        ("bounded", "float64", -1),
        ("three", "uint8", 3),
        ("label", "string", None),
        ("at", "builtin_interfaces/Time", None),
        ("lasted", "builtin_interfaces/Duration", None),
    ]


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("int32 a\n---\nint32 b", "service or action"),
        ("other_msgs/Thing thing", "'other_msgs/Thing' is missing"),
        ("float64", "cannot read"),
        ("Self again", "contains itself"),
        ("Self[] again", "contains itself"),
        ("uint8[0] nothing", "array of no elements"),
    ],
)
def test_definitions_that_cannot_be_used_are_refused_by_name(text: str, what: str) -> None:
    with pytest.raises(CdrError, match=what):
        message_type("demo_msgs/msg/Self", text)


def test_definitions_that_branch_at_every_level_are_checked_in_no_time() -> None:
    # 2^24 ways down from the top, but only 25 types
    levels = [f"T{i + 1} a\nT{i + 1} b\n" for i in range(24)] + ["uint8 x\n"]
    parts = [levels[0]] + [f"MSG: demo_msgs/T{i}\n{body}" for i, body in enumerate(levels) if i]
    kind = message_type("demo_msgs/msg/T0", f"\n{'=' * 80}\n".join(parts))
    with pytest.raises(CdrError, match="more than 100000 fields"):
        layout_of(kind, b"\x00\x01\x00\x00" + bytes(2**20))


def test_arrays_that_claim_more_elements_than_bytes_are_refused_at_once() -> None:
    text = "Point[2000000000] points\n" + "=" * 80 + "\nMSG: demo_msgs/Point\nuint8 x\n"
    with pytest.raises(CdrError, match="ends inside"):
        layout_of(message_type("demo_msgs/msg/Demo", text), b"\x00\x01\x00\x00" + bytes(50))


def test_an_empty_message_takes_the_one_byte_that_ros_gives_it() -> None:
    kind = message_type("std_msgs/msg/Empty", "")
    assert layout_of(kind, b"\x00\x01\x00\x00\x00").length == 5


def test_a_field_that_the_type_lacks_is_refused() -> None:
    with pytest.raises(CdrError, match="no field 'heather'"):
        make_template(known("sensor_msgs/msg/Imu"), {"heather": {}})
    template = make_template(known("sensor_msgs/msg/Imu"))
    with pytest.raises(CdrError, match="no numbers at 'speed'"):
        encode(template, {"speed": np.zeros(2)}, 2)
    with pytest.raises(CdrError, match="is a string"):
        encode(template, {"header.frame_id": np.zeros(2)}, 2)


def test_an_array_of_another_length_is_refused() -> None:
    with pytest.raises(CdrError, match="takes 9 values, not 2"):
        make_template(known("sensor_msgs/msg/Imu"), {"orientation_covariance": [0.0, 1.0]})


def test_known_definitions_agree_with_those_of_another_collection() -> None:
    for name in TYPES:
        assert is_known(name)
        if "foxglove" in name:
            continue
        text = STORE.generate_msgdef(name)[0]
        theirs, ours = message_type(name, text), known(name)
        assert {k: v for k, v in theirs.types.items() if k in ours.types} == dict(ours.types)


def test_stamps_before_the_epoch_keep_their_nanoseconds_positive() -> None:
    columns = stamp_columns("header.stamp", np.array([-1, 1_500_000_000]))
    assert SimpleNamespace(**{key.rsplit(".", 1)[1]: value.tolist() for key, value in columns.items()}) == (
        SimpleNamespace(sec=[-1, 1], nanosec=[999_999_999, 500_000_000])
    )
