"""Prints a line for every stream: actuator, run, samples, largest |i_eq|, frames received and lost.

    pip install iceoryx2==0.10.0
    python watch_telemetry.py               until Ctrl-C
    python watch_telemetry.py --count 1     until the first stream has ended

Every stream's BEGIN and END are answered, so that a lossless publisher waits for this program and
knows what it has received.

Exit code: 0 done, 1 failure, 4 bad input, 130 Ctrl-C.
"""

import argparse
import sys
import time

import ema_stream as ema


class Stream:
    """What has come of a stream."""

    def __init__(self, header):
        self.title = f"{ema.text(header.actuator)} run {header.run}"
        self.next = 0  # number of the expected frame; BEGIN is 0
        self.frames = 0  # sample frames received
        self.whole = 0  # those before the first gap
        self.unbroken = True
        self.samples = 0
        self.largest = 0.0
        self.last = time.monotonic()

    def take(self, frame):
        """Takes a frame; returns whether it wants an answer."""
        h = frame.header
        self.last = time.monotonic()
        if h.kind == ema.BEGIN:
            self.next = max(self.next, 1)
            return True
        if h.kind == ema.SAMPLES and h.frame >= self.next:  # else sent again: nothing new
            self.unbroken &= h.frame == self.next
            self.next = h.frame + 1
            self.frames += 1
            self.whole += self.unbroken
            self.samples += h.rows
            i_eq = dict(frame.columns()).get("i_eq", [0.0])
            self.largest = max(self.largest, max(i_eq), -min(i_eq))
        return h.kind == ema.END

    def line(self, sent=None):
        line = f"{self.title}: {self.samples} samples, largest |i_eq| {self.largest:.4f} A, "
        line += f"{self.frames} frames received, "
        if sent is None:
            return f"{line}{self.next - 1 - self.frames} lost, no END"
        return f"{line}{sent - self.frames} lost"


def watch(subscriber, args):
    streams = {}
    ended = 0
    while args.count is None or ended < args.count:
        while frame := subscriber.receive():
            h = frame.header
            if fault := frame.fault():
                print(f"process {h.process}, frame {h.frame}: {fault}", file=sys.stderr)
                continue
            stream = streams.setdefault(h.stream, Stream(h))
            if stream.take(frame):
                subscriber.answer(h, stream.whole)
            if h.kind == ema.END:
                # END is sent again where it was not delivered: the stream is kept a while
                if stream.title:
                    print(stream.line(h.frame - 1), flush=True)
                    ended += 1
                stream.title = None
        for number, stream in list(streams.items()):
            if time.monotonic() - stream.last > args.timeout:
                if stream.title:
                    print(stream.line(), flush=True)
                    ended += 1
                del streams[number]
        if args.count is None or ended < args.count:
            subscriber.wait(0.5)


def main():
    parser = argparse.ArgumentParser(description="Prints a line for every stream.")
    parser.add_argument("--count", type=int, metavar="N", help="end after N streams")
    help = "a stream without a frame for S seconds is over (10)"
    parser.add_argument("--timeout", type=float, metavar="S", default=10.0, help=help)
    parser.add_argument("--domain", help="instead of EMA_DOMAIN")
    args = parser.parse_args()
    subscriber = ema.TelemetrySubscriber(ema.Domain(args.domain))
    watch(subscriber, args)
    time.sleep(0.2)  # the last answer is lost if its port goes before it has been read
    return 0


if __name__ == "__main__":
    ema.run(main)
