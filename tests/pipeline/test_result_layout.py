"""docs/foxglove-layout.json asks for topics that result.mcap really has."""

from __future__ import annotations

import json
import re
from pathlib import Path

import report_samples as samples
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from smts_validate.pipeline.result import read_result, write_result
from smts_validate.pipeline.result_mcap import write_result_log

LAYOUT = Path(__file__).resolve().parents[2] / "docs" / "foxglove-layout.json"


def test_layout_is_whole_and_its_topics_exist(tmp_path: Path) -> None:
    layout = json.loads(LAYOUT.read_text(encoding="utf-8"))
    out = write_result(tmp_path / "out", samples.pass_result())
    write_result_log(tmp_path / "result.mcap", read_result(out))
    with AnyReader([tmp_path / "result.mcap"], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        topics = {connection.topic for connection in reader.connections}
    asked = set(re.findall(r'"(/(?:measured|simulated|residual|scene)[\w/]*)', json.dumps(layout)))
    assert asked <= topics
    panels = set(re.findall(r'"(\w+!\w+)"', json.dumps(layout["layout"])))
    assert panels == set(layout["configById"])
