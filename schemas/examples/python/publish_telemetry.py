"""An acquisition program: publishes a recorded test as if it were running.

    pip install iceoryx2==0.10.0
    python publish_telemetry.py run.csv                in real time
    python publish_telemetry.py run.csv --speed max    as fast as it is received

The CSV file has columns t,com,theta_u,theta_m,omega_m,i_eq,i_a,i_b,i_c (schemas/README.md,
"Telemetry, CSV"). A rig would fill the columns of a loaned frame from its converters instead.

Exit code: 0 received whole by a subscriber, 3 not, 1 failure, 4 bad input, 130 Ctrl-C.
"""

import argparse
import array
import csv
import math
import os
import sys
import time

import ema_stream as ema

NEEDED = ("com", "theta_m", "omega_m", "i_eq")
AGAIN_S = 0.05  # an unanswered first frame is sent again
STRAGGLERS_S = 0.5  # those who do not answer are waited for so long after the first answer


def rows_of(path):
    """Yields number and values of every line."""
    try:
        with open(path, newline="", encoding="utf-8-sig", errors="replace") as file:
            rows = csv.reader(file)
            for row in rows:
                if row:
                    yield rows.line_num, [value.strip() for value in row]
    except OSError as e:
        raise ema.BadInput(f"{path}: cannot be read: {e.strerror}") from e
    except csv.Error as e:
        raise ema.BadInput(f"{path}: not CSV: {e}") from e


def read_csv(path):
    """Rate [Hz], number of the first sample, columns by name."""
    rows = rows_of(path)
    _, header = next(rows, (1, []))
    if any(header.count(name) != 1 for name in ("t", *NEEDED)):
        found, allowed = ",".join(header), ",".join(("t", *NEEDED))
        raise ema.BadInput(f"{path}, header: found `{found}`; allowed: columns {allowed}, once each")
    columns = {name: array.array("d") for name in header if name == "t" or name in ema.NAMES}
    for line, row in rows:
        if len(row) != len(header):
            raise ema.BadInput(f"{path}, line {line}: found {len(row)} columns; allowed: {len(header)}")
        for name, value in zip(header, row):
            if name in columns:
                try:
                    number = float(value)
                except ValueError:
                    number = math.nan
                if not math.isfinite(number):
                    place = f"{path}, line {line}, column `{name}`"
                    raise ema.BadInput(f"{place}: found `{value}`; allowed: a finite number")
                columns[name].append(number)
    t = columns.pop("t")
    if len(t) < 2 or t[-1] <= t[0]:
        raise ema.BadInput(f"{path}: found {len(t)} rows; allowed: at least 2, times rising")
    rate = (len(t) - 1) / (t[-1] - t[0])
    if abs(rate - round(rate)) < 1e-3 * rate:
        rate = float(round(rate))
    for i, x in enumerate(t):
        if abs(x - t[0] - i / rate) * rate > 0.05:
            raise ema.BadInput(f"{path}, row {i + 1}: found t = {x}; allowed: steps of {1 / rate:g} s")
    # sample n is of the interval that ends at n / rate; t = 0 belongs to none
    first = round(t[0] * rate)
    if first < 0:
        raise ema.BadInput(f"{path}, row 1: found t = {t[0]}; allowed: times from 0 on")
    if first == 0:
        columns = {name: column[1:] for name, column in columns.items()}
    return rate, max(first, 1), columns


class Pass:
    """One sending of a run, as `header` describes it."""

    def __init__(self, publisher, header):
        self.publisher = publisher
        self.header = header
        # another number whenever a run is sent
        self.header.stream = int.from_bytes(os.urandom(8), "little")
        self.begun = set()

    def _empty(self, kind):
        """Sends BEGIN or END."""
        header = ema.FrameHeader.from_buffer_copy(self.header)
        header.kind = kind
        header.rows = header.stride = header.first = header.first_ns = 0
        return self.publisher.send(self.publisher.loan(header))

    def begin(self, patience_s):
        """Sends BEGIN until a subscriber answers, and gives the others a moment. False: nobody did."""
        self.header.frame = 0
        end, sent = time.monotonic() + patience_s, 0.0
        stragglers = None
        while (now := time.monotonic()) < end:
            if now - sent > AGAIN_S:
                sent = now
                self.publisher.clean()
                self._empty(ema.BEGIN)
            self.begun |= {a.subscriber for a in self.publisher.answers(self.header.stream, ema.BEGIN)}
            if self.begun:
                stragglers = stragglers or now + STRAGGLERS_S
                if len(self.begun) >= self.publisher.subscribers() or now > stragglers:
                    break
            time.sleep(0.001)
        self.header.frame = 1
        return bool(self.begun)

    def samples(self, first, columns, patience_s):
        """Sends a frame, again while a subscriber's queue is full: who has it already ignores it.

        False: nobody is left, or one who does not read on. A rig that cannot wait counts the frame as
        lost and goes on.
        """
        header = ema.FrameHeader.from_buffer_copy(self.header)
        header.kind = ema.SAMPLES
        header.set_rows(first, len(next(iter(columns.values()))))
        end = time.monotonic() + patience_s
        while True:
            frame = self.publisher.loan(header)
            for name, place in frame.columns():
                place[:] = columns[name]
            if self.publisher.send(frame) >= max(self.publisher.subscribers(), 1):
                self.header.frame += 1
                return True
            self.publisher.clean()
            if self.publisher.subscribers() == 0 or time.monotonic() > end:
                return False
            time.sleep(0.005)

    def end(self, patience_s):
        """Sends END and waits for the answers of those who answered BEGIN; returns how many
        answered, and how many of them had received every frame."""
        sent = self.header.frame - 1
        answers = {}
        delivered = self._empty(ema.END)
        end, looked = time.monotonic() + patience_s, time.monotonic()
        while (now := time.monotonic()) < end:
            answers |= {a.subscriber: a.frames for a in self.publisher.answers(self.header.stream, ema.END)}
            if self.begun <= answers.keys() or len(answers) >= self.publisher.subscribers():
                break
            if now - looked > AGAIN_S:
                looked = now
                self.publisher.clean()
                delivered = delivered or self._empty(ema.END)
            time.sleep(0.001)
        return len(answers), sum(frames == sent for frames in answers.values())


def parse():
    parser = argparse.ArgumentParser(description="Publishes a recorded test as if it were running.")
    parser.add_argument("file", help="CSV file")
    parser.add_argument("--actuator", default="rig", help="name in the frames, at most 32 bytes (rig)")
    parser.add_argument("--run", type=int, default=0, help="number of the run (0)")
    parser.add_argument("--parameters", default="fd2267d8e432540d", help="fingerprint (reference actuator)")
    parser.add_argument("--sequence", default="516bc48aa11e0fd0", help="fingerprint (preflight)")
    parser.add_argument("--sensors", default="809e38e9a7721c17", help="fingerprint, or none (reference sensors)")
    parser.add_argument("--load", type=float, default=math.nan, help="load torque [N m, motor side] (unknown)")
    parser.add_argument("--frame-ms", type=float, default=10.0, help="duration of a frame [ms] (10)")
    parser.add_argument("--speed", default="1", help="times real time, or max (1)")
    parser.add_argument("--wait", type=float, default=30.0, help="how long to wait for a subscriber [s] (30)")
    parser.add_argument("--domain", help="instead of EMA_DOMAIN")
    args = parser.parse_args()
    try:
        args.speed = math.inf if args.speed == "max" else float(args.speed)
    except ValueError:
        args.speed = math.nan
    if not args.speed > 0:
        raise ema.BadInput("--speed: allowed: a number above 0, or max")
    if args.run < 0:
        raise ema.BadInput(f"--run: found {args.run}; allowed: from 0 on")
    if not 0 < args.frame_ms <= 1000:
        raise ema.BadInput(f"--frame-ms: found {args.frame_ms}; allowed: above 0, at most 1000")
    return args


def main():
    args = parse()
    rate, first, columns = read_csv(args.file)
    count = len(columns["com"])
    rows = max(1, round(args.frame_ms * 1e-3 * rate))
    header = ema.FrameHeader(
        schema_version=ema.SCHEMA_VERSION,
        actuator=ema.to_text(args.actuator, 32),
        parameters=ema.to_number(args.parameters),
        sensors=ema.to_number(args.sensors),
        sequence=ema.to_number(args.sequence),
        run=args.run,
        total_rows=first + count - 1,
        rate_hz=rate,
        load_n_m=args.load,
        channels=sum(1 << n for n, name in enumerate(ema.NAMES) if name in columns),
        process=os.getpid(),
    )
    publisher = ema.TelemetryPublisher(ema.Domain(args.domain), rows, len(columns))
    current = Pass(publisher, header)
    whole, answered, why = 0, 0, f"no subscriber in {args.wait:g} s"
    if current.begin(args.wait):
        start, why = time.monotonic(), "a subscriber has gone or does not read on"
        for a in range(0, count, rows):
            block = {name: column[a : a + rows] for name, column in columns.items()}
            # a sample is known when its interval has ended
            due = start + (first - 1 + a + len(block["com"])) / rate / args.speed
            time.sleep(max(0.0, due - time.monotonic()))
            if not current.samples(first + a, block, args.wait):
                break
        else:
            answered, whole = current.end(args.wait)
            why = f"{answered} of {len(current.begun)} subscribers have answered, none has all of it"
    what = f"{args.actuator} run {args.run}: {count} samples, {current.header.frame - 1} frames"
    if whole:
        print(f"{what}: received whole by {whole} of {answered} subscribers")
        return 0
    print(f"{what}: not received whole: {why}", file=sys.stderr)
    return 3


if __name__ == "__main__":
    ema.run(main)
