"""Prints diagnoses as they come.

    pip install iceoryx2==0.10.0
    python watch_diagnoses.py                 final diagnoses, one line each, until Ctrl-C
    python watch_diagnoses.py --all --json    those so far too, as JSON with the keys of the log
    python watch_diagnoses.py --count 1 --timeout 60

Exit code: 0 done, 3 fewer than --count in --timeout, 1 failure, 4 bad input, 130 Ctrl-C.
"""

import argparse
import json
import math
import sys
import time

import ema_stream as ema


def known(x):
    return None if math.isnan(x) else x


def interval(m, fault):
    return {k: known(getattr(m, f"{fault}_{k}")) for k in ("lo", "hi", "estimate")}


def to_dict(m):
    """The message with the keys of a log of `ema live`."""
    contradicting = [name for n, (name, _) in enumerate(ema.FEATURES) if m.contradicting >> n & 1]
    return {
        "time_ns": time.time_ns() - (ema.now_ns() - m.publish_ns),
        "actuator": ema.text(m.actuator),
        "parameters": ema.from_number(m.parameters),
        "sequence": ema.from_number(m.sequence),
        "run": m.run,
        "stream": f"{m.stream:016x}",
        "final": bool(m.is_final),
        "outcome": ema.OUTCOMES.get(m.outcome, str(m.outcome)),
        "fsj": interval(m, "fsj"),
        "zeta": interval(m, "zeta"),
        "area": known(m.area),
        "coverage": m.coverage,
        "features": {key: known(getattr(m, key)) for key in ema.FEATURE_KEYS},
        "contradicting": contradicting,
        "reason": ema.text(m.reason),
        "samples_received": m.samples_received,
        "samples_lost": m.samples_lost,
        "telemetry_ns": m.telemetry_ns,
        "publish_ns": m.publish_ns,
    }


def to_line(m):
    """The message for a person."""
    has_area = not math.isnan(m.area)
    line = f"{ema.text(m.actuator)} run {m.run}:{'' if m.is_final else ' so far'}"
    if m.is_final or not has_area:
        line += " " + ema.OUTCOMES.get(m.outcome, f"outcome {m.outcome}").replace("_", " ")
    if has_area:
        line += f" FSJ {m.fsj_estimate:.4f} ({m.fsj_lo:.4f} .. {m.fsj_hi:.4f})"
        line += f", zeta {m.zeta_estimate:.5f} ({m.zeta_lo:.5f} .. {m.zeta_hi:.5f})"
    return f"{line}: {ema.text(m.reason)}" if m.is_final and m.reason else line


def main():
    parser = argparse.ArgumentParser(description="Prints diagnoses as they come.")
    parser.add_argument("--all", action="store_true", help="diagnoses so far too, not only final ones")
    parser.add_argument("--json", action="store_true", help="a JSON object a line")
    parser.add_argument("--count", type=int, metavar="N", help="end after N final diagnoses")
    parser.add_argument("--timeout", type=float, metavar="S", default=math.inf, help="end after S seconds")
    parser.add_argument("--history", type=int, metavar="N", default=0, help="N sent before, at most 64")
    parser.add_argument("--domain", help="instead of EMA_DOMAIN")
    args = parser.parse_args()
    diagnoses = ema.DiagnosisSubscriber(ema.Domain(args.domain), args.history)
    end = time.monotonic() + args.timeout
    final = 0
    while args.count is None or final < args.count:
        message = diagnoses.next(end - time.monotonic())
        if message is None:
            if args.count is not None:
                print(f"{final} of {args.count} diagnoses in {args.timeout:g} s", file=sys.stderr)
            return 0 if args.count is None else 3
        final += message.is_final
        if message.is_final or args.all:
            print(json.dumps(to_dict(message)) if args.json else to_line(message), flush=True)
    return 0


if __name__ == "__main__":
    ema.run(main)
