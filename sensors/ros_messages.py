"""Definitions of the ROS 2 messages that logs and results hold, as the `ros2msg` text of MCAP schemas.

Source: ros2/common_interfaces, ros2/geometry2 (tf2_msgs) and foxglove/foxglove-sdk (foxglove_msgs); fields
only, in their order: the order is the wire format.
"""

from __future__ import annotations

import re

SEPARATOR = "=" * 80

_POSE = "geometry_msgs/Pose pose"
_COLOR = "foxglove_msgs/Color color"

_BODIES: dict[str, str] = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/Float64": "float64 data",
    "std_msgs/String": "string data",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseStamped": f"std_msgs/Header header\n{_POSE}",
    "geometry_msgs/PoseWithCovariance": f"{_POSE}\nfloat64[36] covariance",
    "geometry_msgs/QuaternionStamped": "std_msgs/Header header\ngeometry_msgs/Quaternion quaternion",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/TwistStamped": "std_msgs/Header header\ngeometry_msgs/Twist twist",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
    ),
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "nav_msgs/Odometry": (
        "std_msgs/Header header\nstring child_frame_id\n"
        "geometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist"
    ),
    "nav_msgs/Path": "std_msgs/Header header\ngeometry_msgs/PoseStamped[] poses",
    "sensor_msgs/Imu": (
        "std_msgs/Header header\n"
        "geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance"
    ),
    "sensor_msgs/MagneticField": (
        "std_msgs/Header header\ngeometry_msgs/Vector3 magnetic_field\nfloat64[9] magnetic_field_covariance"
    ),
    "sensor_msgs/NavSatStatus": (
        "int8 STATUS_NO_FIX=-1\nint8 STATUS_FIX=0\nint8 STATUS_SBAS_FIX=1\nint8 STATUS_GBAS_FIX=2\n"
        "int8 status\n"
        "uint16 SERVICE_GPS=1\nuint16 SERVICE_GLONASS=2\nuint16 SERVICE_COMPASS=4\nuint16 SERVICE_GALILEO=8\n"
        "uint16 service"
    ),
    "sensor_msgs/NavSatFix": (
        "std_msgs/Header header\nsensor_msgs/NavSatStatus status\n"
        "float64 latitude\nfloat64 longitude\nfloat64 altitude\nfloat64[9] position_covariance\n"
        "uint8 COVARIANCE_TYPE_UNKNOWN=0\nuint8 COVARIANCE_TYPE_APPROXIMATED=1\n"
        "uint8 COVARIANCE_TYPE_DIAGONAL_KNOWN=2\nuint8 COVARIANCE_TYPE_KNOWN=3\n"
        "uint8 position_covariance_type"
    ),
    "sensor_msgs/JointState": (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort"
    ),
    "foxglove_msgs/Color": "float64 r\nfloat64 g\nfloat64 b\nfloat64 a",
    "foxglove_msgs/KeyValuePair": "string key\nstring value",
    "foxglove_msgs/ArrowPrimitive": (
        f"{_POSE}\nfloat64 shaft_length\nfloat64 shaft_diameter\nfloat64 head_length\n"
        f"float64 head_diameter\n{_COLOR}"
    ),
    "foxglove_msgs/CubePrimitive": f"{_POSE}\ngeometry_msgs/Vector3 size\n{_COLOR}",
    "foxglove_msgs/SpherePrimitive": f"{_POSE}\ngeometry_msgs/Vector3 size\n{_COLOR}",
    "foxglove_msgs/CylinderPrimitive": (
        f"{_POSE}\ngeometry_msgs/Vector3 size\nfloat64 bottom_scale\nfloat64 top_scale\n{_COLOR}"
    ),
    "foxglove_msgs/LinePrimitive": (
        f"uint8 LINE_STRIP=0\nuint8 LINE_LOOP=1\nuint8 LINE_LIST=2\nuint8 type\n{_POSE}\n"
        f"float64 thickness\nbool scale_invariant\ngeometry_msgs/Point[] points\n{_COLOR}\n"
        "foxglove_msgs/Color[] colors\nuint32[] indices"
    ),
    "foxglove_msgs/TriangleListPrimitive": (
        f"{_POSE}\ngeometry_msgs/Point[] points\n{_COLOR}\nfoxglove_msgs/Color[] colors\nuint32[] indices"
    ),
    "foxglove_msgs/TextPrimitive": (
        f"{_POSE}\nbool billboard\nfloat64 font_size\nbool scale_invariant\n{_COLOR}\nstring text"
    ),
    "foxglove_msgs/ModelPrimitive": (
        f"{_POSE}\ngeometry_msgs/Vector3 scale\n{_COLOR}\nbool override_color\nstring url\n"
        "string media_type\nuint8[] data"
    ),
    "foxglove_msgs/SceneEntityDeletion": (
        "builtin_interfaces/Time timestamp\nuint8 MATCHING_ID=0\nuint8 ALL=1\nuint8 type\nstring id"
    ),
    "foxglove_msgs/SceneEntity": (
        "builtin_interfaces/Time timestamp\nstring frame_id\nstring id\n"
        "builtin_interfaces/Duration lifetime\nbool frame_locked\n"
        "foxglove_msgs/KeyValuePair[] metadata\nfoxglove_msgs/ArrowPrimitive[] arrows\n"
        "foxglove_msgs/CubePrimitive[] cubes\nfoxglove_msgs/SpherePrimitive[] spheres\n"
        "foxglove_msgs/CylinderPrimitive[] cylinders\nfoxglove_msgs/LinePrimitive[] lines\n"
        "foxglove_msgs/TriangleListPrimitive[] triangles\nfoxglove_msgs/TextPrimitive[] texts\n"
        "foxglove_msgs/ModelPrimitive[] models"
    ),
    "foxglove_msgs/SceneUpdate": (
        "foxglove_msgs/SceneEntityDeletion[] deletions\nfoxglove_msgs/SceneEntity[] entities"
    ),
}


def short_name(name: str) -> str:
    """`package/msg/Type` or `package/Type` as `package/Type`, the form used inside definitions."""
    parts = name.split("/")
    return f"{parts[0]}/{parts[-1]}" if len(parts) == 3 else name


def is_known(name: str) -> bool:
    """Whether `definition(name)` has a text for this type."""
    return short_name(name) in _BODIES


def definition(name: str) -> str:
    """The complete `ros2msg` schema text of a type, dependencies included.

    Raises KeyError for a type that is not among those of this module.
    """
    top = short_name(name)
    needed = [top]
    for each in needed:
        needed.extend(d for d in _dependencies(_BODIES[each]) if d not in needed)
    parts = [f"MSG: {each}\n{_BODIES[each]}\n" for each in needed[1:]]
    return f"\n{SEPARATOR}\n".join([_BODIES[top] + "\n", *parts])


def _dependencies(body: str) -> list[str]:
    return list(dict.fromkeys(re.findall(r"^(\w+/\w+)", body, flags=re.MULTILINE)))
