#!/usr/bin/env python3
"""Studies the cases of servo.py or actuator.py with the program as its users have it, and opens the keys after.

    python judge.py EMA SET [--jobs N] [--bad]

EMA is the program, SET a folder that servo.py or actuator.py wrote; its key is KEYS/<name of SET>.json, where the generators put it
beside themselves. A case is right where the exact set of names is told (nothing hidden: `none` or `retune` without a name; an effect
that is told as one of two that cannot be told apart counts). A line each case: what was hidden and told, gaps over their floors on
held-out data (nominal, re-tuned, with the effects), constants and parameters in per cent and in half-widths of their 95 % intervals.
"""

import argparse
import concurrent.futures as futures
import json
import os
import subprocess
import sys
import time
from collections import defaultdict


def study(ema, folder):
    """Report of a case, or the refusal."""
    files = sorted(f for f in os.listdir(folder) if f.endswith(".csv"))
    bench = os.path.join(folder, "bench.toml")
    if os.path.exists(bench):
        what = [bench]
    else:
        what = [os.path.join(folder, f) for f in files] + ["--actuator", "reference"]
    began = time.time()
    done = subprocess.run(
        [ema, "discrepancy", "--quiet", "--json", "--healthy", "--bench", *what],
        capture_output=True,
        text=True,
        env=dict(os.environ, RAYON_NUM_THREADS="1"),
    )
    try:
        return json.loads(done.stdout), time.time() - began
    except json.JSONDecodeError:
        return (done.stderr or done.stdout).strip(), time.time() - began


def is_right(report, hidden):
    told = {e["name"] for e in report["effects"]}
    verdict = report["verdict"]
    if hidden is None:
        return verdict in ("none", "retune") and not told
    alike = any(hidden in [e["name"], *e["ambiguous_with"]] for e in report["effects"])
    return verdict != "unknown" and (told == {hidden} or verdict == "ambiguous" and len(told) == 1 and alike)


def off(value, truth):
    """Per cent and half-widths that an estimate is off; None where there is no interval."""
    if value is None or truth is None or value["lo"] is None or value["hi"] is None:
        return None
    half = 0.5 * (value["hi"] - value["lo"])
    z = (value["value"] - truth) / half if half > 0 else float("inf")
    return 100.0 * (value["value"] / truth - 1.0) if truth else 0.0, z


def gaps(report):
    out = []
    for channel, gap in (report["gap"].get("by_channel") or {}).items():
        held = gap.get("heldout") or {}
        if held.get("floor"):
            out.append(channel + " " + " > ".join(f"{held[k] / held['floor']:.2f}" for k in ("nominal", "retuned", "final")))
    return ", ".join(out)


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("ema")
    p.add_argument("set")
    p.add_argument("--jobs", type=int, default=1)
    p.add_argument("--bad", action="store_true", help="lines of the wrong ones alone")
    a = p.parse_args()
    name = os.path.basename(a.set.rstrip("/"))
    keys = os.path.join(os.path.dirname(os.path.abspath(__file__)), "keys", name + ".json")
    with open(keys) as f:
        cases = json.load(f)["cases"]
    inside, parameters, by_effect, times = defaultdict(list), [], defaultdict(list), []
    with futures.ThreadPoolExecutor(a.jobs) as pool:
        jobs = [pool.submit(study, a.ema, os.path.join(a.set, c["case"])) for c in cases]
        for case, job in zip(cases, jobs):
            report, seconds = job.result()
            hidden = case.get("effect")
            times.append(seconds)
            if isinstance(report, str):
                by_effect[hidden or "nothing"].append(False)
                print("BAD", case["case"], hidden, "refused:", report)
                continue
            right = is_right(report, hidden)
            by_effect[hidden or "nothing"].append(right)
            words = []
            for key, truth in case.get("constants", {}).items():
                found = off((report.get("retuned") or {}).get(key), truth)
                if found:
                    inside[key].append(abs(found[1]) <= 1)
                    words.append(f"{key} {found[0]:+.2f} % ({found[1]:+.1f})")
            for effect in report["effects"]:
                for key, value in effect["parameters"].items():
                    truth = case.get("parameters", {}).get(key) if effect["name"] == hidden else None
                    found = off(value, truth) if isinstance(truth, (int, float)) else None
                    if found:
                        parameters.append(abs(found[1]) <= 1)
                        words.append(f"{key} {value['value']:.4g} for {truth:.4g} ({found[1]:+.1f})")
            told = "+".join(e["name"] for e in report["effects"])
            if not (a.bad and right):
                print("OK " if right else "BAD", case["case"], hidden, "->", report["verdict"], told, f"{seconds:.1f} s |", gaps(report), "|", "; ".join(words))
                sys.stdout.flush()
    every = [x for of in by_effect.values() for x in of]
    print(f"right {sum(every)} of {len(every)}; median {sorted(times)[len(times) // 2]:.1f} s")
    print("by effect:", ", ".join(f"{k} {sum(v)}/{len(v)}" for k, v in sorted(by_effect.items())))
    print("intervals hold:", ", ".join(f"{k} {sum(v)}/{len(v)}" for k, v in inside.items()), f"; of effects {sum(parameters)}/{len(parameters)}")


if __name__ == "__main__":
    main()
