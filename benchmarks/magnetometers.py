"""What the magnetometers are worth: yaw with and without them over seeded twins, clean and magnetised.

    python benchmarks/magnetometers.py [--passes 4]

Cases: benign RTK, an outage of 30 s, two rows with a headland turn, a metre-level receiver, and that with gyros five
times as poor. A magnetised machine has soft iron (5 % of the field) and currents that switch (2 µT) beside every unit.
Prints root mean squares of both yaws' errors in degrees with / without magnetometers, coverage of 1.96 stated
deviations likewise, and how many of the units proved consistent.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "pipeline"))

from fusion_samples import changed, errors, make, rms
from smts_validate.pipeline.fusion.fuse import fuse
from smts_validate.pipeline.fusion.settings import FusionSettings
from smts_validate.pipeline.twin_plan import TwinPlan, preset

POOR = {"errors__noise_scale": 5.0, "errors__bias_scale": 5.0}
CASES: dict[str, TwinPlan] = {
    "benign": preset("benign"),
    "outage 30 s": changed(preset("benign"), gnss__outages=((20.0, 30.0),)),
    "headland": preset("headland"),
    "metre level": preset("metre_gps"),
    "metre level, poor gyros": changed(preset("metre_gps"), **POOR),
}
MACHINES = {"clean": {}, "magnetised": {"errors__soft_iron": 0.05, "errors__current_field": 2e-6}}
OPTIONS = FusionSettings(draws=2)


def one(plan: TwinPlan, seed: int) -> tuple[np.ndarray, int]:
    """Errors (2 yaws, with and without, rms in degrees and coverage) of a pass, and units used."""
    heading = float(np.random.default_rng(seed).uniform(-180.0, 180.0))
    of = make(changed(plan, place__heading_deg=heading), 3000 + seed)
    out = np.empty((2, 2, 2))
    used = 0
    for i, options in enumerate((OPTIONS, replace(OPTIONS, magnetometers=False))):
        motion = fuse(of.log, options)
        for j, name in enumerate(("yaw1", "yaw2")):
            error, sd = errors(motion, of)[name]
            out[j, i] = np.degrees(rms(error)), np.mean(np.abs(error) < 1.96 * sd)
        used += sum("value" in entry.get("magnetometer", {}) for entry in motion.noise.values())
    return out, used


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--passes", type=int, default=4)
    chosen = parser.parse_args()
    print(
        "with / without                       tractor yaw, deg    coverage     seeder yaw, deg    coverage    used"
    )
    for case, plan in CASES.items():
        for machine, errors_of in MACHINES.items():
            rows = [one(changed(plan, **errors_of), seed) for seed in range(chosen.passes)]
            values = np.array([row[0] for row in rows])
            size, share = np.sqrt(np.mean(values[..., 0] ** 2, axis=0)), values[..., 1].mean(axis=0)
            used = sum(row[1] for row in rows)
            print(
                f"{case + ', ' + machine:36s}"
                + "".join(
                    f"{size[j, 0]:8.4f} / {size[j, 1]:6.4f}   {share[j, 0]:5.3f} / {share[j, 1]:5.3f}"
                    for j in (0, 1)
                )
                + f"{used:5d} of {2 * chosen.passes}",
                flush=True,
            )
