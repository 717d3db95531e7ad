#!/usr/bin/env python3
"""Studies the cases of rigs.py with the program as its users have it, and opens the key after.

    python judge_rigs.py EMA SET [CASE...]

EMA is the program, SET a folder that rigs.py wrote; its key is keys_SET.json beside it. One line a case: OK or BAD, what was hidden, the rig,
verdict and names. Right is the exact set of names and no `unknown` (nothing hidden: `none` or `retune` without a name; outside the list:
`unknown`; an effect that is told as one of two that cannot be told apart counts). What the key calls `also_true` does not count.
"""

import json
import os
import sys
from concurrent.futures import ThreadPoolExecutor

from judge import study


def is_right(report, case):
    told = {e["name"] for e in report["effects"]}
    hidden = {e["name"] for e in case["effects"]}
    verdict = report["verdict"]
    if case["class"] == "nothing":
        return verdict in ("none", "retune") and not told
    if case["class"] == "outside":
        return verdict == "unknown"
    alike = any(hidden & {e["name"], *e["ambiguous_with"]} for e in report["effects"])
    return verdict != "unknown" and (told == hidden or verdict == "ambiguous" and len(told) == 1 and alike)


def main():
    ema, folder, *only = sys.argv[1:]
    folder = os.path.normpath(folder)
    with open(os.path.join(os.path.dirname(folder), f"keys_{os.path.basename(folder)}.json")) as f:
        key = [c for c in json.load(f) if not only or str(c["case"]) in only]
    right = 0
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        studies = pool.map(lambda c: study(ema, os.path.join(folder, f"case_{c['case']:03d}")), key)
        for case, (report, seconds) in zip(key, studies):
            rig = case["rig"]
            hidden = ",".join(sorted(e["name"] for e in case["effects"])) or "-"
            what = f"{case['case']} {hidden} [{rig['kind']} {rig['drive']} {rig['motion']} {rig['rate_hz']:.0f} Hz, speed: {rig['velocity']}, {rig['sampling']}]"
            if isinstance(report, str):
                print(f"REFUSED {what}: {report[:300]}", flush=True)
                continue
            ok = is_right(report, case)
            right += ok
            names = [e["name"] for e in report["effects"]]
            print(f"{'OK ' if ok else 'BAD'} {what} -> {report['verdict']} {names} {seconds:.0f} s", flush=True)
    print(f"{right} of {len(key)}")


if __name__ == "__main__":
    main()
