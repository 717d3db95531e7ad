#!/usr/bin/env python3
"""Studies the cases of rigs.py with the program as its users have it, and opens the key after.

    python judge_rigs.py EMA SET [CASE...]

EMA is the program, SET a folder that rigs.py wrote; its key is keys_SET.json beside it. One line a case: OK or BAD, what was hidden, the rig,
verdict and names. Right is the exact set of names and no `unknown` (nothing hidden: `none` or `retune` without a name; outside the list:
`unknown`; an effect that is told as one of two that cannot be told apart counts). The last line counts those, and after it those that are right
where names of what the key calls `also_true` (offsets of sensors, an amplifier's own lag) are no mistake.
"""

import json
import os
import sys
from concurrent.futures import ThreadPoolExecutor
from itertools import permutations

from judge import study


def is_right(report, case, also=False):
    told = [{e["name"], *e["ambiguous_with"]} for e in report["effects"]]
    hidden = [e["name"] for e in case["effects"]]
    true = {e["name"] for e in case["also_true"]} if also else set()
    verdict = report["verdict"]
    if case["class"] == "outside":
        return verdict == "unknown"
    if not told:
        return not hidden and verdict in ("none", "retune")
    if verdict == "unknown" or len(told) < len(hidden):
        return False

    def fits(order):
        rest = order[len(hidden):]
        return all(h in t for h, t in zip(hidden, order)) and all(t & true for t in rest)

    return any(map(fits, permutations(told)))


def main():
    ema, folder, *only = sys.argv[1:]
    folder = os.path.normpath(folder)
    with open(os.path.join(os.path.dirname(folder), f"keys_{os.path.basename(folder)}.json")) as f:
        key = [c for c in json.load(f) if not only or str(c["case"]) in only]
    right = true = 0
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
            true += is_right(report, case, also=True)
            names = [e["name"] for e in report["effects"]]
            print(f"{'OK ' if ok else 'BAD'} {what} -> {report['verdict']} {names} {seconds:.0f} s", flush=True)
    print(f"{right} of {len(key)}, {true}")


if __name__ == "__main__":
    main()
