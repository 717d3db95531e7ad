#!/usr/bin/env python3
"""The whole way of actuators whose recordings lie in folders, with the program as its users have it.

    python circle.py EMA UNITS [--from K] [--to K] [--work DIR]

EMA is the program, UNITS a folder of folders unit-0, unit-1, ... each with healthy_long_*.csv (studied), healthy_*.csv (pre-flight
tests of the healthy unit, taken into its file), fresh_*.csv (more of them, to be diagnosed), test_*.csv (of faulty states) and
truth.json: "hidden" (an effect's name or null) and "tests" ([FSJ, zeta] each). One line a unit, each test that is not inside both
intervals, and the sums. What the program writes goes to a folder of its own in DIR (default: UNITS/work).
"""

import argparse
import glob
import json
import math
import os
import statistics
import subprocess


def run(ema, cache, *args):
    env = dict(os.environ, EMA_CACHE_DIR=cache)
    done = subprocess.run([ema, *args], capture_output=True, text=True, env=env)
    try:
        return json.loads(done.stdout), done.stderr
    except json.JSONDecodeError:
        return {}, done.stderr


def wilson(k, n):
    if n == 0:
        return "none"
    z, p = 1.96, k / n
    mid, half = (p + z * z / (2 * n)) / (1 + z * z / n), z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n)
    return f"{k} of {n}, {100 * p:.1f} [{100 * (mid - half):.1f}, {100 * (mid + half):.1f}] %"


def median(values):
    return statistics.median(values) if values else float("nan")


def judged(d, truth):
    """Inside both, widths and errors in widths."""
    if d.get("outcome") != "located":
        return False, None
    widths, errors, inside = [], [], True
    for fault, true in zip(("fsj", "zeta"), truth):
        f = d[fault]
        lo, hi = f["lo"], f["hi"]
        inside &= lo <= true <= hi
        widths.append(hi - lo)
        errors.append((f["estimate"] - true) / (hi - lo) if hi > lo else math.inf)
    return inside, (widths, errors)


def main():
    a = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    a.add_argument("ema")
    a.add_argument("units")
    a.add_argument("--from", dest="first", type=int, default=0)
    a.add_argument("--to", dest="last", type=int, default=10**9)
    a.add_argument("--work")
    a.add_argument("--most", type=int, default=10**9, help="tests of each sort that are diagnosed of a unit: each rest angle needs maps of its own")
    a.add_argument("--step", type=int, default=1, help="every so many units, from the first")
    a = a.parse_args()
    work = a.work or os.path.join(a.units, "work")
    folders = sorted((int(f.rsplit("-", 1)[1]), f) for f in glob.glob(os.path.join(a.units, "unit-*")))
    tests, above = [], [0, 0]
    print("| unit | hidden | study | healthy tests taken | inside | not located | width FSJ %, median | width zeta | fresh healthy above 1.1 |")
    print("|---|---|---|---|---|---|---|---|---|")
    for k, folder in folders:
        if not a.first <= k <= a.last or (k - a.first) % a.step:
            continue
        own = os.path.join(work, f"unit-{k}")
        os.makedirs(own, exist_ok=True)
        cache, study, unit = (os.path.join(own, name) for name in ("cache", "study", "unit.json"))
        files = lambda name: sorted(glob.glob(os.path.join(folder, name)), key=lambda f: int(f.rsplit("_", 1)[1][:-4]))
        some = lambda name: files(name)[: a.most]
        with open(os.path.join(folder, "truth.json")) as f:
            truth = json.load(f)
        effect = truth.get("effect")
        truth.setdefault("hidden", effect.get("name") if isinstance(effect, dict) else effect)
        report, _ = run(a.ema, cache, "discrepancy", "--bench", *files("healthy_long_*.csv"), "--healthy", "--out", study, "--json")
        names = "+".join(e["name"] for e in report.get("effects", []))
        if os.path.exists(unit):
            os.remove(unit)
        _, said = run(a.ema, cache, "unit", "new", unit, "--study", study)
        healthy = files("healthy_[0-9]*.csv")
        run(a.ema, cache, "unit", "update", unit, *healthy, "--healthy")
        shown, _ = run(a.ema, cache, "unit", "show", unit, "--json")
        mine = []
        for n, file in enumerate(some("test_*.csv")):
            d, said = run(a.ema, cache, "diagnose", file, "--unit", unit, "--json")
            faults = truth["tests"][n]
            inside, found = judged(d, faults)
            mine.append((d.get("outcome"), inside, found, faults))
            if not inside:
                tell = [[round(d[f][key], 4) for key in ("lo", "estimate", "hi")] for f in ("fsj", "zeta")] if d.get("fsj", {}).get("lo") else said.strip()[:200]
                print(f"    unit {k} test {n}: {d.get('outcome')} at {faults}: {tell} {','.join(d.get('contradicting') or [])}", flush=True)
        over = 0
        for file in some("fresh_*.csv"):
            d, _ = run(a.ema, cache, "diagnose", file, "--unit", unit, "--json")
            lo = (d.get("fsj") or {}).get("lo")
            over += d.get("outcome") == "located" and lo is not None and lo > 1.1
            above[1] += 1
        above[0] += over
        located = [t for t in mine if t[0] == "located"]
        print(
            f"| {k} | {truth['hidden'] or 'nothing'} | {report.get('verdict')} {names} | {shown.get('healthy_tests')} | "
            f"{sum(t[1] for t in mine)} of {len(mine)} | {len(mine) - len(located)} | "
            f"{median([100 * t[2][0][0] / t[3][0] for t in located]):.2f} | {median([t[2][0][1] for t in located]):.4f} | {over} |",
            flush=True,
        )
        tests += [(k, truth["hidden"], *t) for t in mine]
    located = [t for t in tests if t[2] == "located"]
    plain = [t for t in tests if not t[1]]
    off = lambda by: sum(max(abs(e) for e in t[4][1]) > by for t in located)
    print(f"\n- truth inside both intervals: {wilson(sum(t[3] for t in tests), len(tests))}")
    print(f"- of those located: {wilson(sum(t[3] for t in located), len(located))}; of plain units: {wilson(sum(t[3] for t in plain), len(plain))}")
    print(f"- located, truth outside: {wilson(sum(not t[3] for t in located), len(tests))}")
    print(f"- off by more than the interval is wide: {wilson(off(1), len(tests))}; by twice: {wilson(off(2), len(tests))}")
    print(f"- not located: {wilson(len(tests) - len(located), len(tests))}")
    print(f"- width of FSJ, median: {median([100 * t[4][0][0] / t[5][0] for t in located]):.2f} %")
    print(f"- fresh healthy tests above FSJ 1.1: {wilson(*above)}")


if __name__ == "__main__":
    main()
