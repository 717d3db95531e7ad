"""Units of units.py as the reference folder has them: one long recording, pre-flight tests without voltages, all from one rest angle.

    python one_recording.py --seed S --units N --tests M --out DIR [--effect NAME|none]

One rest angle saves the maps of all others; recordings and truth are otherwise those of units.py, which is imported as it is.
"""

import argparse
import math
import os

import numpy as np

import units

CHANNELS = 9  # of a test: up to the phase currents


def record(constants, name, effect, command, fsj, zeta, seed, unit, tag):
    draws = np.random.default_rng([seed, unit, *tag])
    draws.uniform(0, 2 * math.pi)  # the rest angle, which is 0 here
    plant = units.vector(constants, name, effect, fsj, zeta, 0.0)
    return units.sensors(units.simulate(command, 1_000_000 // units.RATE, plant), plant, draws), 0.0


def write(path, rows):
    name = os.path.basename(path)
    if name.startswith("fresh") or name == "healthy_long_2.csv":
        return
    count = None if name.startswith("healthy_long") else CHANNELS
    columns = units.HEAD.split(",")[:count]
    formats = (units.FMT.split(",")[:5] + ["%.8g"] * 8)[:count]
    with open(path, "w") as f:
        f.write(",".join(columns) + "\n")
        f.writelines(",".join(formats) % tuple(r[:count]) + "\n" for r in rows.tolist())


def main():
    a = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    a.add_argument("--seed", type=int, required=True)
    a.add_argument("--units", type=int, required=True)
    a.add_argument("--tests", type=int, required=True)
    a.add_argument("--out", required=True)
    a.add_argument("--effect")
    a = a.parse_args()
    units.record, units.write = record, write
    for k in range(a.units):
        units.unit(a.seed, k, a.tests, a.out, a.effect)
        print(f"unit-{k} done", flush=True)


if __name__ == "__main__":
    main()
