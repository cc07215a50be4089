"""A batch as a process of its own, to be killed: real workers and store, the chain replaced by a slow writer.

python batch_killed.py RAW OUT WORKERS
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

from smts_validate.pipeline import batch, batch_task
from smts_validate.pipeline.batch_task import Outcome, Task, run_task
from smts_validate.sensors import manifest as manifests

FILES = 6
SLOW = 0.01  # s a file


@dataclass(frozen=True)
class Written:
    """What `compute` gives back, as far as the batch looks at it."""

    manifest: Any
    metrics: dict[str, Any]


def compute(source: Path, out: Path, manifest: Path | None, settings: Any, fingerprint: str) -> Written:
    """Write a result file by file, each of them a function of the pass's manifest alone."""
    given, text = manifests.read(source / "run.toml")
    out.mkdir()
    (out / "run.toml").write_text(text, encoding="utf-8")
    for number in range(FILES):
        content = hashlib.sha256(f"{text}{number}".encode()).hexdigest() * 200
        (out / f"file{number}").write_text(content, encoding="utf-8")
        time.sleep(SLOW)
    metrics = {
        "run": given.run.id,
        "verdict": {"value": "inconclusive"},
        "provenance": {"fingerprint": fingerprint},
        "files": FILES,
    }
    (out / "metrics.json").write_text(json.dumps(metrics), encoding="utf-8")
    return Written(SimpleNamespace(run=given.run), metrics)


def replace_chain(put: Callable[[dict[str, Any], str, Any], None]) -> None:
    """Put a module in the chain's place that is quick to import, unlike the real one."""
    chain = ModuleType("smts_validate.pipeline.run")
    chain.compute = compute  # type: ignore[attr-defined]
    put(sys.modules, chain.__name__, chain)  # type: ignore[arg-type]


def work(task: Task) -> Outcome:
    """A worker's task with the chain replaced."""
    replace_chain(dict.__setitem__)
    batch_task.program_digest = lambda: "the program under test"
    return run_task(task)


def nothing(computing: bool) -> None:
    """In place of a worker's imports: the real chain takes longer to import than this batch to run."""


def quick(task: Task) -> Outcome:
    """The same without the slowness that a batch to be killed needs."""
    global SLOW
    SLOW = 0.0
    return work(task)


def is_whole(result: Path) -> bool:
    """Whether a result folder holds all that `compute` writes."""
    wanted = {"run.toml", "metrics.json", *(f"file{number}" for number in range(FILES))}
    found = {path.name for path in result.iterdir()}
    return found == wanted and all(path.stat().st_size > 0 for path in result.iterdir())


def main() -> None:
    """Run the batch of the arguments; prints its summary."""
    sys.path.insert(0, str(Path(__file__).parent))
    import batch_killed  # under the name by which its workers know it too

    batch.get_ready = batch_killed.nothing
    raw, out, workers = sys.argv[1:]
    request = batch.Request(paths=(raw,), out=out, workers=int(workers), summarise=False)
    sys.stdout.write(json.dumps(batch.run_batch(request, lambda progress: None, batch_killed.work)))


if __name__ == "__main__":
    main()
